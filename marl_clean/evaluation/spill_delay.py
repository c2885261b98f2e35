"""How long spilt cells stay dirty, counted while a batch of environments steps."""

import torch
from jaxtyping import Bool
from torch import Tensor

from marl_clean.world.state import State

SPILL_MEASURES = ("spill_delay", "spill_cleaned")


class SpillDelay:
    """Counts the steps for which each spilt cell is not cleaned: in all, and over how many cells.

    The sum over cells of their steps is the sum over steps of the cells that were open before, so
    two numbers a world are enough, whatever its size.
    """

    def __init__(self, state: State) -> None:
        assert state.num_spilt is not None and state.num_open_spilt is not None
        self.num_spilt, self.num_open = state.num_spilt, state.num_open_spilt
        self.open_steps = torch.zeros_like(self.num_spilt)

    def update(self, state: State, live: Bool[Tensor, " env"]) -> None:
        """Count one step in the worlds that are still measured."""
        assert state.num_spilt is not None and state.num_open_spilt is not None
        self.open_steps = self.open_steps + torch.where(live, self.num_open, 0)
        self.num_spilt = torch.where(live, state.num_spilt, self.num_spilt)
        self.num_open = torch.where(live, state.num_open_spilt, self.num_open)

    def columns(self) -> dict[str, list[float | None]]:
        """Return each of SPILL_MEASURES for every world; None where nothing was spilt."""
        counts = (self.num_spilt, self.open_steps, self.num_open)
        delays: list[float | None] = []
        cleaned: list[float | None] = []
        for spilt, steps, left in zip(*(count.tolist() for count in counts), strict=True):
            delays.append(steps / spilt if spilt else None)
            cleaned.append((spilt - left) / spilt if spilt else None)
        return dict(zip(SPILL_MEASURES, (delays, cleaned), strict=True))
