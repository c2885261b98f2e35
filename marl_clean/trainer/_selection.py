"""The best weights on validation houses."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from marl_clean.errors import BadInput
from marl_clean.storage.checkpoint import Checkpoints


class Best:
    """The weights that a measure on validation houses chose so far, saved as they are chosen.

    Attributes:
        by: the measure; of times (T_...) the lowest is best, of all others the highest.
        record: frames, measures and weights of the best; None before the first evaluation.
    """

    def __init__(self, by: str, checkpoints: Checkpoints) -> None:
        self.by, self.checkpoints = by, checkpoints
        self.sign = -1.0 if by.startswith("T_") else 1.0
        self.record: dict[str, Any] | None = None

    def offer(self, frames: int, measured: Mapping[str, float], weights: dict[str, Tensor]) -> None:
        """Keep and save the weights if they are better than all before."""
        if self.by not in measured:
            raise BadInput(f"trainer.select_by={self.by}: valid: {', '.join(sorted(measured))}")
        value = self.sign * measured[self.by]
        if self.record is None or value > self.sign * self.record["measured"][self.by]:
            self.record = {"frames": frames, "measured": dict(measured), "weights": weights}
            self.save()

    def save(self) -> None:
        """Save the best again, for a resumed run whose folder lacks it."""
        if self.record is not None:
            frames, measured = self.record["frames"], self.record["measured"]
            self.checkpoints.save("best", frames, self.record["weights"], measured)

    def summary(self) -> dict[str, Any] | None:
        """Return frames and measures of the best, without its weights."""
        if self.record is None:
            return None
        return {"frames": self.record["frames"], **self.record["measured"]}
