"""All jobs of a sweep while it runs, from what they write into their folders.

A table where stderr is a terminal, else a line for each change and a summary now and then.
"""

import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from marl_clean.commands.run_info import RunInfo, Score, State, last_validation, look
from marl_clean.config.stored import METRICS
from marl_clean.storage.lock import LOCK

MOST_ROWS = 20
ENDED = (State.FINISHED, State.FAILED)
NONE = "-"


class Pace:
    """A job's speed, since metrics.csv holds no times: its frames against its last change."""

    def __init__(self) -> None:
        self.first: tuple[int, float] | None = None
        self.newest = 0
        self.speed: float | None = None

    def note(self, frames: int, at: float) -> float | None:
        """Return frames a second between the first row and the newest; None before a second row."""
        if self.first is None or frames < self.newest:
            self.first = (frames, at)
        elif frames > self.newest and at > self.first[1]:
            self.speed = (frames - self.first[0]) / (at - self.first[1])
        self.newest = frames
        return self.speed


class Watch:
    """Shows the jobs of a sweep as long as the context lasts.

    Args:
        folders: of the jobs, by their names.
        labels: what sets each job apart from the others.
        console: where to write; stderr.
        every_seconds: between two looks at the folders.
        lines_every_seconds: between two summaries where there is no terminal.
    """

    def __init__(
        self,
        folders: Mapping[str, Path],
        labels: Mapping[str, str],
        console: Console | None = None,
        every_seconds: float = 1.0,
        lines_every_seconds: float = 60.0,
    ) -> None:
        self.folders, self.labels = folders, labels
        # Jobs in this process print into their logs, for which sys.stderr is exchanged.
        self.console = console or Console(file=sys.stderr, soft_wrap=True)
        self.every, self.lines_every = every_seconds, lines_every_seconds
        self.infos: dict[str, RunInfo] = {}
        self.paces = {name: Pace() for name in folders}
        self.ended = threading.Event()
        self.last_summary = time.monotonic()
        self.live = Live(
            console=self.console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self.thread = threading.Thread(target=self._watch, name="sweep", daemon=True)

    def __enter__(self) -> "Watch":
        self._look()
        if self.console.is_terminal:
            self.live.start()
        self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.ended.set()
        self.thread.join()
        self._show()
        self.live.stop()

    def _watch(self) -> None:
        while not self.ended.wait(self.every):
            self._show()

    def _show(self) -> None:
        changes = self._look()
        if self.console.is_terminal:
            self.live.update(Group(self.table(), Text(self.summary())), refresh=True)
            return
        for info in changes:
            self._print(self.line(info))
        if time.monotonic() - self.last_summary >= self.lines_every:
            self.last_summary = time.monotonic()
            for info in self.infos.values():
                if info.state is State.RUNNING:
                    self._print(self.line(info))
            self._print(self.summary())

    def _print(self, line: str) -> None:
        self.console.print(f"{time.strftime('%H:%M:%S')} {line}", markup=False, highlight=False)

    def _look(self) -> list[RunInfo]:
        """Look at every job that has not ended; return those whose state is another now."""
        changes = []
        for name, folder in self.folders.items():
            before = self.infos.get(name)
            if before is not None and before.state in ENDED and not (folder / LOCK).exists():
                continue
            try:
                info = look(folder, name)
            except OSError:  # a folder that goes away
                continue
            self.infos[name] = info
            if info.state is State.RUNNING:
                self.paces[name].note(info.frames, _written(folder / METRICS))
            if before is not None and before.state is not info.state:
                changes.append(info)
        return changes

    def summary(self) -> str:
        """How many jobs are in which state, and how long the rest may take."""
        counts = Counter(info.state for info in self.infos.values())
        listed = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
        left = self.seconds_left()
        return f"{len(self.infos)} jobs: {listed}" + (
            "" if left is None else f"; {clock(left)} left"
        )

    def seconds_left(self) -> float | None:
        """The frames left over the speed of those that run; None while there is no speed yet."""
        running = [name for name, info in self.infos.items() if info.state is State.RUNNING]
        speeds = [speed for name in running if (speed := self.paces[name].speed)]
        if not speeds:
            return None
        total = max((info.total_frames or 0 for info in self.infos.values()), default=0)
        left = sum(
            max((info.total_frames or total) - info.frames, 0)
            for info in self.infos.values()
            if info.state not in ENDED
        )
        return left / (sum(speeds) / len(speeds) * len(running))

    def cells(self, info: RunInfo) -> list[str]:
        """The job's state, share of frames, frames a second, score and time left."""
        speed = self.paces[info.name].speed if info.state is State.RUNNING else None
        share = f"{100 * info.frames // info.total_frames} %" if info.total_frames else NONE
        left = max(0, (info.total_frames or 0) - info.frames)  # the last block may be longer
        score = info.reason or shown(info.score) or NONE
        if info.state is State.RUNNING and (latest := last_validation(info.folder)):
            score = f"validation {latest[0]} {latest[1]:.1f}"
        return [
            info.state.value,
            share,
            f"{speed:,.0f}" if speed else NONE,
            score,
            clock(left / speed) if speed else NONE,
        ]

    def line(self, info: RunInfo) -> str:
        """One job in one line of a log file."""
        state, share, speed, score, left = self.cells(info)
        more = [f"{speed} frames/s", f"{left} left"] if speed != NONE else []
        parts = [f"{info.name} ({self.labels[info.name]}): {state}", share, *more, score]
        return ", ".join(part for part in parts if part != NONE)

    def table(self) -> Table:
        """The jobs that run or failed, and the latest of the others as far as there is room."""
        table = Table(box=box.SIMPLE_HEAD)
        for title in ("job", "", "state", "frames", "frames/s", "score", "left"):
            table.add_column(title, justify="right" if title.startswith("fr") else "left")
        order = [State.RUNNING, State.FAILED, State.FINISHED, State.UNFINISHED, State.WAITING]
        infos = sorted(self.infos.values(), key=lambda i: (order.index(i.state), -i.changed))
        for info in infos[:MOST_ROWS]:
            cells = (Text(cell) for cell in (info.name, self.labels[info.name], *self.cells(info)))
            table.add_row(*cells)
        return table


def shown(score: Score | None) -> str:
    """A score in words; empty without one."""
    if score is None:
        return ""
    ratio = "" if score.of_planner is None else f" ({score.of_planner:.2f} x the planner's)"
    return f"{score.measure} {score.mean:.1f}{ratio}"


def clock(seconds: float) -> str:
    """A time in hours, minutes and seconds."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def labels_of(jobs: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Of each job's settings those that not all jobs have, but for the name."""
    common = set.intersection(*(set(settings) for settings in jobs.values())) if jobs else set()
    return {
        name: " ".join(s for s in settings if s not in common and not s.startswith("name="))
        for name, settings in jobs.items()
    }


def _written(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return time.time()
