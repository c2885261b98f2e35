"""Where the metrics of a training run go: into files, and onto the terminal."""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from marl_clean.config.stored import CONFIG
from marl_clean.storage.safe_yaml import load_yaml

CLOCK = "time/"
"""Prefix of the metrics that depend on the clock, in which equal runs differ."""

SHOWN = ("loss", "epsilon", "coverage")


class Logger(ABC):
    """Stores one row of named values per log interval."""

    @abstractmethod
    def resume(self, frames: int) -> None:
        """Forget what was logged after `frames`: the run resumes there.

        Called after `restore` where the run's state holds what this logger has logged.
        """

    @abstractmethod
    def log(self, frames: int, values: Mapping[str, float]) -> None:
        """Log the values of a run after `frames` frames."""

    @abstractmethod
    def close(self) -> None:
        """Write everything to the disk."""

    def state(self) -> str:
        """Return what was logged so far, for the run's state; empty where it is not needed."""
        return ""

    def restore(self, state: str) -> None:  # noqa: B027, most have no state
        """Have logged what `state` holds, whatever became of the files."""

    def add_replay(self, gif: Path, frames: int) -> None:  # noqa: B027, most hold numbers alone
        """Show the replay of a run that ended after `frames` frames, where pictures are shown.

        Called after `close`, of a logger that may have logged nothing itself.
        """


def stored_settings(folder: Path) -> dict[str, Any]:
    """The settings of the run in a folder, as plain data; none where it has no config."""
    path = folder / CONFIG
    return load_yaml(path) if path.is_file() else {}


class Progress:
    """Shows a run's progress: a bar where stderr is a terminal, else a line now and then.

    Args:
        total_frames: the run's budget.
        first_frames: those collected before this process began, by a resumed run.
        every_seconds: between lines where there is no terminal.
    """

    def __init__(self, total_frames: int, first_frames: int, every_seconds: float = 30.0) -> None:
        self.total, self.first = total_frames, first_frames
        self.every_seconds = every_seconds
        self.started = self.last_line_at = time.monotonic()
        self.latest: dict[str, float] = {}
        self.console = Console(stderr=True, soft_wrap=True)
        self.bar = Bar(
            TextColumn("{task.completed:,.0f} frames"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[shown]}"),
            TimeRemainingColumn(),
            console=self.console,
            disable=not sys.stderr.isatty(),
        )
        self.task = self.bar.add_task("", total=total_frames, completed=first_frames, shown="")

    def __enter__(self) -> "Progress":
        self.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.stop()

    def frames_per_second(self, frames: int) -> float:
        """Return the speed since this process began to train."""
        return (frames - self.first) / max(time.monotonic() - self.started, 1e-9)

    def show(self, frames: int, values: Mapping[str, float]) -> None:
        """Show a run after `frames` frames; a metric without a new value keeps its last."""
        self.latest |= values
        speed = self.frames_per_second(frames)
        parts = [f"{speed:,.0f} frames/s"]
        parts += [f"{name} {self.latest[name]:.3g}" for name in SHOWN if name in self.latest]
        self.bar.update(self.task, completed=frames, shown="  ".join(parts))
        if self.bar.disable and time.monotonic() - self.last_line_at >= self.every_seconds:
            self.last_line_at = time.monotonic()
            left = (self.total - frames) / max(speed, 1e-9)
            self.say(f"{frames:,} of {self.total:,} frames  {'  '.join(parts)}  {left:.0f} s left")

    def say(self, line: str) -> None:
        """Write one line to stderr, above the bar where there is one."""
        self.console.print(line, markup=False, highlight=False)
