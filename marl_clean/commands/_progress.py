"""The progress of an evaluation and the time that is left, on stderr."""

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


class EvaluationProgress:
    """A bar where stderr is a terminal, else a line now and then.

    Args:
        num_policies: how many are measured, one after another.
        every_seconds: between lines where there is no terminal.
    """

    def __init__(self, num_policies: int, every_seconds: float = 30.0) -> None:
        self.num_policies, self.every_seconds = num_policies, every_seconds
        self.names: list[str] = []
        self.started = self.last_line = time.monotonic()
        self.console = Console(stderr=True, soft_wrap=True)
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=not sys.stderr.isatty(),
            transient=True,
        )
        self.task = self.bar.add_task("", total=num_policies)

    def __enter__(self) -> "EvaluationProgress":
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.stop()

    def show(self, name: str, share: float) -> None:
        """Show the measured share of the policy `name`; a new name is the next policy."""
        if not self.names:
            self.bar.start()  # not earlier: tasks without houses report no progress
        if name not in self.names:
            self.names.append(name)
        number = len(self.names)
        label = f"{name} ({number} of {self.num_policies})"
        self.bar.update(self.task, description=label, completed=number - 1 + share)
        now = time.monotonic()
        if self.bar.disable and now - self.last_line >= self.every_seconds:
            self.last_line = now
            whole = (number - 1 + share) / self.num_policies
            left = (now - self.started) * (1 - whole) / max(whole, 1e-9)
            self.console.print(
                f"{label}: {int(100 * share)} %, about {left:,.0f} s left in all",
                markup=False,
                highlight=False,
            )
