"""A disk that is full: `python -m tests.reliability.full_disk --trials 200`.

A tiny training meets a full disk at a random filesystem call: from then on every call that needs
space fails (ENOSPC). Or no file of it may grow beyond a limit (RLIMIT_FSIZE, EFBIG). It must end
with one line that names the file, without a damaged checkpoint; when there is space again, the same
command must end with the files of a run that never met a full disk, and none beside.
"""

import argparse
import errno
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import torch

from tests.reliability.calls import Call, told
from tests.reliability.forks import Broken, Fork, train
from tests.reliability.kills import Training

SPACE = ("open", "mkdir", "write", "flush", "fsync")  # calls that a full disk can refuse
MOST_BYTES = 40_000  # a little more than the largest file of such a run
REASONS = (os.strerror(errno.ENOSPC), os.strerror(errno.EFBIG))
IsFull = Callable[[Call], bool]


@contextmanager
def full_from(is_full: IsFull) -> Iterator[None]:
    """Within this context the disk is full, from the first call on for which `is_full` holds."""
    full = False

    def tell(call: Call) -> None:
        nonlocal full
        if call.done or call.name not in SPACE:
            return
        full = full or is_full(call)
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with told(tell):
        yield


@contextmanager
def limited_to(size: int) -> Iterator[None]:
    """Within this context no file may become larger; Python ignores the signal that tells so."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def from_call(number: int) -> IsFull:
    """Full from the call of this number on."""
    made = 0

    def is_full(call: Call) -> bool:
        nonlocal made
        made += 1
        return made > number

    return is_full


def under(name: str, number: int) -> IsFull:
    """Full from the call of this number on, of those about paths with `name` in them."""
    counts = from_call(number)
    return lambda call: name in call.path and counts(call)


def fill(training: Training, within: AbstractContextManager[None]) -> str:
    """Train where there is too little space, and again where there is enough.

    Returns the last line that was said between; none where there was enough. Raises Broken.
    """
    folder = Path(tempfile.mkdtemp(dir=training.place))
    said = Fork(training.config, folder, within=within, may_refuse=True).refused.splitlines()
    for line in said:
        if "cannot be" not in line or not line.endswith(REASONS):
            raise Broken(f"{training.kind}: says {line!r}")
    training.check_whole(folder)
    Fork(training.config, folder)
    training.compare(folder)
    shutil.rmtree(folder)
    return said[-1] if said else ""


def file_in(line: str, training: Training) -> str:
    """What could not be written, without the place of the run and the number of frames."""
    path = Path(line.partition(": cannot be")[0])
    name = path.relative_to(training.place).parts[1:] or ("its folder",)
    return name[-1].partition("-0")[0]


def try_all(training: Training, trials: int, seed: int = 0) -> Counter[str]:
    """Fill the disk so often; return how often what could not be written. Raises Broken."""
    draw = random.Random(seed)
    calls: list[Call] = []
    with told(calls.append):
        train(training.config, Path(tempfile.mkdtemp(dir=training.place)))
    needing = sum(call.name in SPACE and not call.done for call in calls)
    refused: Counter[str] = Counter()
    for trial in range(trials):
        if trial % 4:
            within = full_from(from_call(draw.randrange(needing)))
        else:
            within = limited_to(draw.randrange(300, MOST_BYTES))
        line = fill(training, within)
        refused[file_in(line, training) if line else "nothing"] += 1
    return refused


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        refused = try_all(Training("iql", Path(place)), arguments.trials)
    listed = ", ".join(f"{name} {number}" for name, number in refused.most_common())
    sys.stdout.write(
        f"{arguments.trials} full disks (refused: {listed}): 0 tracebacks, 0 damaged checkpoints,"
        f" 0 leftovers, 0 files that differ; {time.monotonic() - began:.0f} s\n"
    )


if __name__ == "__main__":
    main()
