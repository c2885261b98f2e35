"""Mutated files of every format: `python -m tests.reliability.mutations --trials 2000`.

Whole files are damaged and filled with hostile texts, and fed to the function that the commands
read them with. Each must be read, or refused by a BadInput of one short line. Anything else is a
fault: another exception, a warning, more than a second of computing, 256 MiB more of memory. Half
of the files that are kept with a digest have it renewed, as a stranger can.

Trials run in forked children, in batches: a child's peak of memory is its own, and what a reader
leaves in it is gone with the child.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from marl_clean.errors import BadInput
from tests.reliability.formats import FORMATS, Format
from tests.reliability.mutators import mutated

MOST_SECONDS = 1.0  # of computing
HANG_SECONDS = 20  # on the clock, when other processes compute, too
MOST_KIB = 256 << 10
LONGEST_LINE = 500
BATCH = 100


@dataclass
class Counted:
    """What became of a format's mutations."""

    read: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)
    seconds: float = 0.0  # of the longest trial
    kib: int = 0  # of the trial that took the most memory

    def add(self, other: "Counted") -> None:
        self.read += other.read
        self.refused += other.refused
        self.faults += other.faults
        self.seconds, self.kib = max(self.seconds, other.seconds), max(self.kib, other.kib)


def attempt(read: Callable[[], object]) -> Counted:
    """Read once, and count what became of it."""
    result = Counted()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    signal.alarm(HANG_SECONDS)
    try:
        read()
        result.read = 1
    except BadInput as error:
        result.refused = 1
        text = str(error)
        if not text.isprintable() or len(text) > LONGEST_LINE or "\n" in text:
            result.faults.append(f"no short line: {text[:LONGEST_LINE]!r}")
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        result.faults.append(f"{type(error).__name__}: {str(error)[:200]!r} in {where}")
    finally:
        signal.alarm(0)
    result.seconds = time.process_time() - began
    result.kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if result.seconds > MOST_SECONDS:
        result.faults.append(f"took {result.seconds:.2f} s")
    if result.kib > MOST_KIB:
        result.faults.append(f"took {result.kib >> 10} MiB")
    return result


def batch(format: Format, whole: Path, place: Path, seeds: range) -> Counted:
    """The mutations of these seeds, in folders below `place`."""
    counted = Counted()
    original = (whole / format.path).read_bytes()
    for seed in seeds:
        draw = random.Random(seed)
        folder = place / "trial"
        shutil.copytree(whole, folder)
        content = mutated(original, draw, format)
        (folder / format.path).write_bytes(content)
        if format.seal is not None and draw.random() < 0.75:
            format.seal(folder)
        one = attempt(lambda folder=folder: format.read(folder))  # type: ignore[misc]
        one.faults = [f"seed {seed}: {fault}" for fault in one.faults]
        counted.add(one)
        shutil.rmtree(folder)
    return counted


def in_child(work: Callable[[], Counted]) -> Counted:
    """What `work` returns in a forked child; a child that dies is a fault."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            warnings.simplefilter("error")
            sys.stderr = open(os.devnull, "w")  # noqa: SIM115  # readers log what they pass over
            with os.fdopen(writing, "w") as file:
                try:
                    counted = work()
                except Exception:  # of the harness itself
                    counted = Counted(faults=[f"the harness: {traceback.format_exc()[-300:]}"])
                json.dump(asdict(counted), file)
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as file:
        text = file.read()
    _, status = os.waitpid(child, 0)
    if not text:
        return Counted(faults=[f"a child ended with status {status}"])
    return Counted(**json.loads(text))


def run(name: str, trials: int, first: int = 0) -> Counted:
    """The first `trials` mutations of a format from the seed `first` on."""
    format, counted = FORMATS[name], Counted()
    with tempfile.TemporaryDirectory() as folder:
        whole, place = Path(folder) / "whole", Path(folder) / "trials"
        whole.mkdir()
        place.mkdir()
        format.make(whole)
        format.read(whole)
        for start in range(first, first + trials, BATCH):
            seeds = range(start, min(start + BATCH, first + trials))
            counted.add(in_child(lambda seeds=seeds: batch(format, whole, place, seeds)))  # type: ignore[misc]
            shutil.rmtree(place)
            place.mkdir()
    return counted


def line_of(name: str, trials: int, counted: Counted, seconds: float) -> str:
    """The figures of a format."""
    return (
        f"{name}: {trials} mutations, {counted.read} read, {counted.refused} refused in one line,"
        f" {len(counted.faults)} faults; at most {counted.seconds:.2f} s and"
        f" {counted.kib / 1024:.0f} MiB more; {seconds:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", choices=[[], *FORMATS])
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--faults", type=int, default=5, help="how many are shown of a format")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    total = Counted()
    names = arguments.formats or list(FORMATS)
    for name in names:
        began = time.monotonic()
        counted = run(name, arguments.trials, arguments.first)
        total.add(counted)
        sys.stdout.write(line_of(name, arguments.trials, counted, time.monotonic() - began) + "\n")
        for fault in counted.faults[: arguments.faults]:
            sys.stdout.write(f"  {fault}\n")
        sys.stdout.flush()
    sys.stdout.write(line_of("all", arguments.trials * len(names), total, 0.0) + "\n")
    sys.exit(bool(total.faults))


if __name__ == "__main__":
    main()
