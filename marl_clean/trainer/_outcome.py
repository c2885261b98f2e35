"""What became of a training."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        frames, updates: collected and done in all.
        best: frames and measures of the weights chosen on validation houses; None without any.
        was_finished: nothing was left to do.
    """

    frames: int
    updates: int
    best: dict[str, Any] | None
    was_finished: bool
