"""The same command twice at once: `python -m tests.reliability.at_once --trials 10`.

Two processes train the same run, or run the same sweep, begun within a tenth of a second. Of a run
one must train and the other say which process holds it, with exit code 2; of a sweep every job
must be run once, and each driver end with 0, or with 1 where the other still had a job.
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.reliability.short_jobs import environment
from tests.reliability.sweeps import journal

TRAIN = ["train", "budget=smoke", "name=mine"]
SECONDS = 4.0  # of a job
SWEEP = ["train", "-m", "budget=smoke", "seed=range(100,104)", "hydra/launcher=basic"]
WITHOUT_LOCKS = """
from marl_clean.storage import lock
lock._lock, lock.holder, lock.check_free = lambda _: True, lambda _: None, lambda _: None
"""


class Broken(AssertionError):
    """A promise that did not hold."""


def twice(place: Path, command: list[str], gap: float, planted: str = "") -> list[tuple[int, str]]:
    """Run a command twice at once; return the exit codes, and what each said."""
    settings = environment(place / "path", SECONDS)
    with (place / "path" / "sitecustomize.py").open("a") as file:
        file.write(planted)
    processes = []
    for _ in range(2):
        processes.append(
            subprocess.Popen(
                [sys.executable, "-m", "marl_clean", *command],
                cwd=place,
                env=settings,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        )
        time.sleep(gap)
    said = [process.communicate(timeout=300)[0] for process in processes]
    return [(process.returncode, text) for process, text in zip(processes, said, strict=True)]


def check_run(place: Path, gap: float, planted: str = "") -> bool:
    """Train the same run twice; return whether the second came while the first trained.

    Raises Broken where both train at once, or the other's line is wrong.
    """
    ends = sorted(twice(place, TRAIN, gap, planted))
    events = Counter(event for event, *_ in journal(place))
    if [event for event, *_ in journal(place)] == ["begin", "end"] * 2:
        return False  # on a busy machine: the stand-in does not look whether a run is finished
    [holder] = {pid for _, _, pid in journal(place)[:1]}
    refused = ends[1][1].startswith(f"marl-clean: runs/mine: held by process {holder} on ")
    if [code for code, _ in ends] != [0, 2] or events != {"begin": 1, "end": 1} or not refused:
        raise Broken(f"{gap:.3f} s apart: {ends}, {events}")
    return True


def check_sweep(place: Path, gap: float, planted: str = "") -> None:
    """Run the same sweep twice. Raises Broken where a job is not run once, or a driver fails."""
    ends = twice(place, SWEEP, gap, planted)
    runs = Counter(name for event, name, _ in journal(place) if event == "end")
    begun = sum(event == "begin" for event, *_ in journal(place))
    codes = sorted(code for code, _ in ends)
    if len(runs) != 4 or begun != 4 or codes not in ([0, 0], [0, 1]):
        raise Broken(f"{gap:.3f} s apart: {begun} begun, ended {runs}, {ends}")


def check(trials: int, seed: int = 0) -> str:
    """Do both so often; return a line of what was seen."""
    draw, met = random.Random(seed), 0
    for _ in range(trials):
        with tempfile.TemporaryDirectory() as place:
            met += check_run(Path(place), draw.uniform(0, 0.1))
        with tempfile.TemporaryDirectory() as place:
            check_sweep(Path(place), draw.uniform(0, 0.1))
    return (
        f"{met} runs and {trials} sweeps of 4 jobs begun twice at once: 0 trained twice, 0 left"
        " out, 0 drivers failed"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10)
    sys.stdout.write(check(parser.parse_args().trials) + "\n")


if __name__ == "__main__":
    main()
