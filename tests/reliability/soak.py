"""Train, evaluate and report again and again: `python -m tests.reliability.soak --seconds 1800`.

One process trains a tiny run, evaluates it, writes its page, and removes it. Memory, threads, open
files and the files that are left must be at the end what they were after the first cycles.
"""

import argparse
import gc
import io
import os
import shutil
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import torch

from marl_clean import cli

SMALL = [
    *("experiment=quick", "budget=smoke", "train_houses=8", "house.rows=[5,5]", "house.cols=[5,6]"),
    *("env.num_envs=8", "env.max_steps=20", "evaluation.houses=2", "evaluation.plans=[]"),
    *("trainer.total_frames=256", "trainer.frames_per_batch=64", "trainer.start_frames=64"),
    *("trainer.batch_frames=16", "trainer.buffer_frames=512", "logger=csv", "name=soaked"),
]
WARM = 3  # cycles in which libraries load and caches fill
GROWTH = 0.05  # of memory, between the first and the last third of the others


class Broken(AssertionError):
    """Something has grown."""


@dataclass(frozen=True)
class Held:
    """What the process holds between two cycles."""

    kib: int
    threads: int
    open_files: int
    left: tuple[str, ...]


def cycle() -> None:
    """Train a run, evaluate it, write its page, and remove all of it."""
    evaluated = ["evaluate", "checkpoint=soaked", "out=measured.json"]
    for command in (["train", *SMALL], evaluated, ["report", "runs/soaked", "--out", "page.html"]):
        said = io.StringIO()
        with redirect_stdout(said), redirect_stderr(said):
            code = cli.main(command)
        if code:
            raise Broken(f"{command[0]} ends with {code}: {said.getvalue()[-500:]}")
    for path in ("measured.json", "page.html"):
        Path(path).unlink()
    shutil.rmtree("runs/soaked")


def held() -> Held:
    """What this process holds now, after garbage was collected."""
    gc.collect()
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    left = tuple(sorted(str(path) for path in Path().rglob("*") if path.is_file()))
    files = len(os.listdir("/proc/self/fd"))
    return Held(int(status["VmRSS"].split()[0]), threading.active_count(), files, left)


def soak(seconds: float, least: int = 12, work: Callable[[], None] = cycle) -> str:
    """Go through cycles for so long, and at least so many; return a line of what was seen.

    Raises Broken where something has grown.
    """
    began, seen = time.monotonic(), []
    with tempfile.TemporaryDirectory() as place, chdir(place):
        while len(seen) < least or time.monotonic() - began < seconds:
            work()
            seen.append(held())
    steady = seen[WARM:]
    third = len(steady) // 3
    before, after = (
        statistics.median(each.kib for each in part) for part in (steady[:third], steady[-third:])
    )
    if after > (1 + GROWTH) * before:
        raise Broken(f"memory grew from {before / 1024:.0f} to {after / 1024:.0f} MiB")
    for name in ("threads", "open_files", "left"):
        first, last = getattr(steady[0], name), getattr(steady[-1], name)
        if first != last:
            raise Broken(f"{name}: {first} became {last}")
    return (
        f"{len(seen)} cycles: memory {before / 1024:.0f} MiB, then {after / 1024:.0f};"
        f" {steady[-1].threads} threads and {steady[-1].open_files} open files as before;"
        f" {time.monotonic() - began:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=1800)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    sys.stdout.write(soak(arguments.seconds) + "\n")


if __name__ == "__main__":
    main()
