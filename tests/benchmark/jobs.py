"""What a job of a sweep costs beyond its training: `python -m tests.benchmark.jobs`.

Jobs of no length run in turn in this process; the files that they leave are timed on their own.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

from tests.reliability import short_jobs

JOBS, STARTS = 32, 3


def sweep_seconds(first_seed: int, jobs: int) -> float:
    """The seconds of a sweep of `jobs` jobs."""
    from marl_clean.commands import sweep

    with Path(os.devnull).open("w") as nowhere:
        began = time.perf_counter()
        seeds = f"seed=range({first_seed},{first_seed + jobs})"
        sweep.run(["hydra/launcher=basic", "budget=smoke", seeds], Console(file=nowhere))
        return time.perf_counter() - began


def bare_seconds(first_seed: int, jobs: int) -> float:
    """The seconds of the same jobs without a sweep, their config composed once."""
    from marl_clean.config.stored import RUNS, compose_for_training

    config = compose_for_training(["budget=smoke"])
    began = time.perf_counter()
    for seed in range(first_seed, first_seed + jobs):
        config.seed, config.name = seed, f"bare-{seed}"
        (RUNS / config.name).mkdir()
        short_jobs.main(config, RUNS / config.name)
    return time.perf_counter() - began


def main() -> None:
    os.environ[short_jobs.SECONDS] = "0"
    short_jobs.install()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        sweep_seconds(0, 2)  # imports
        for start in range(1, STARTS + 1):
            swept = sweep_seconds(100 * start, JOBS) / JOBS
            bare = bare_seconds(100 * start, JOBS) / JOBS
            sys.stdout.write(f"{swept:.2f} s a job, {bare:.2f} s of it without the sweep\n")


if __name__ == "__main__":
    main()
