"""A sweep under fire: `python -m tests.reliability.sweeps basic joblib ... --jobs 64`.

Under each launcher one sweep of jobs of a second runs in peace, and one is disturbed: as many
workers as a fifth of its jobs are killed with SIGKILL while they train (in turn, the worker is the
driver), then the driver; the same command follows until it ends with 0. Every job must then be
finished, no finished one may have been run twice, and the two last tables must be the same.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.reliability.short_jobs import JOURNAL, environment

MOST_STARTS = 40
OF_LAUNCHER = {
    "basic": [],
    "joblib": ["hydra.launcher.n_jobs=2"],
    "submitit_local": ["hydra.launcher.timeout_min=10"],
    "ray": [],
}


def command(launcher: str, jobs: int) -> list[str]:
    """The command of a sweep."""
    settings = [f"seed=range(100,{100 + jobs})", f"hydra/launcher={launcher}"]
    return [
        *(sys.executable, "-m", "marl_clean", "train", "-m", "budget=smoke"),
        *(*settings, *OF_LAUNCHER[launcher]),
    ]


def journal(place: Path) -> list[list[str]]:
    """The lines so far: event, job, process."""
    path = place / JOURNAL
    return [line.split() for line in path.read_text().splitlines()] if path.exists() else []


def finished(place: Path) -> int:
    """The number of jobs that have ended."""
    return sum(event == "end" for event, *_ in journal(place))


def training(place: Path) -> dict[str, int]:
    """The jobs that have begun and not ended, and their processes."""
    inside: dict[str, int] = {}
    for event, name, pid in journal(place):
        if event == "begin":
            inside[name] = int(pid)
        else:
            inside.pop(name, None)
    return inside


class Sweep:
    """One sweep in a folder of its own."""

    def __init__(self, place: Path, launcher: str, jobs: int, seconds: float) -> None:
        self.place, self.launcher, self.jobs = place, launcher, jobs
        self.environment = environment(place / "path", seconds)
        self.printed = place / "printed.txt"
        self.starts = self.kills = 0
        self.wall = 0.0

    def start(self) -> subprocess.Popen[bytes]:
        """Start the command.

        It prints into a file: a worker that outlives its driver would keep a pipe open.
        """
        self.starts += 1
        with self.printed.open("wb") as file:
            return subprocess.Popen(
                command(self.launcher, self.jobs),
                cwd=self.place,
                env=self.environment,
                stdout=file,
                stderr=subprocess.STDOUT,
            )

    def run(self) -> tuple[int, str]:
        """Run the command to its end; return its exit code and what it printed."""
        began = time.monotonic()
        code = self.start().wait()
        self.wall += time.monotonic() - began
        return code, self.printed.read_text()

    def disturb(self, kills: int) -> None:
        """Kill `kills` workers while they train, one now and then, and then the driver."""
        draw, killed = random.Random(0), set()
        process = self.start()
        for _ in range(kills):
            while not (inside := set(training(self.place).values()) - killed):
                if process.poll() is not None:
                    process = self.start()
                time.sleep(0.02)
            time.sleep(draw.uniform(0, 0.5))
            victim = draw.choice(sorted(inside))
            killed.add(victim)
            try:
                os.kill(victim, signal.SIGKILL)
                self.kills += 1
            except ProcessLookupError:
                continue
        while not training(self.place) and process.poll() is None:
            time.sleep(0.02)
        process.kill()
        process.wait()

    def complete(self) -> str:
        """Give the same command until it ends with 0; return its last table."""
        for _ in range(MOST_STARTS):
            code, out = self.run()
            if code == 0:
                return table(out)
        raise AssertionError(f"still not finished after {MOST_STARTS} starts:\n{out}")


def table(out: str) -> str:
    """The table in what the command printed, without what is shown while it runs."""
    lines = out.splitlines()
    first = next(number for number, line in enumerate(lines) if "result on its test" in line)
    return "\n".join(lines[first:])


def check(launcher: str, jobs: int, seconds: float, kills: int) -> str:
    """Run both sweeps; return a line of what was seen.

    Raises AssertionError where a promise broke.
    """
    with tempfile.TemporaryDirectory() as folder:
        peaceful = Sweep(Path(folder) / "peace", launcher, jobs, seconds)
        code, out = peaceful.run()
        assert code == 0, out
        war = Sweep(Path(folder) / "war", launcher, jobs, seconds)
        war.disturb(kills)
        at_kill = finished(war.place)
        final = war.complete()
        ends = Counter(name for event, name, _ in journal(war.place) if event == "end")
        assert len(ends) == jobs, f"{len(ends)} of {jobs} finished"
        assert set(ends.values()) == {1}, f"run twice: {[n for n, c in ends.items() if c > 1]}"
        assert final == table(out), f"other tables:\n{final}\n{table(out)}"
        return (
            f"{launcher}: {len(ends)} of {jobs} finished, none twice, same table;"
            f" {war.kills} workers killed, driver killed at {at_kill}, {war.starts} starts;"
            f" in peace {peaceful.wall:.1f} s"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("launchers", nargs="+", choices=OF_LAUNCHER)
    parser.add_argument("--jobs", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=1.0)
    arguments = parser.parse_args()
    for launcher in arguments.launchers:
        kills = max(1, arguments.jobs // 5)
        sys.stdout.write(check(launcher, arguments.jobs, arguments.seconds, kills) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
