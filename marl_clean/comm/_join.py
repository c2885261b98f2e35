"""How what a robot hears joins its features."""

from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn


class Join(nn.Module):
    """Join a hearer's features h with what the scheme makes of them and of messages, s.

        residual: h' = h + W s        gated: h' = GRU(s, h)
        a robot that hears nothing: h' = h, to the bit

    Source: gated, DCC (arXiv 2109.05413).
    """

    def __init__(self, kind: Literal["residual", "gated"], before: int, given: int) -> None:
        super().__init__()
        self.added = nn.Linear(given, before, bias=False) if kind == "residual" else None
        self.gate = nn.GRUCell(given, before) if kind == "gated" else None

    def forward(
        self,
        before: Float[Tensor, "*batch agent feature"],
        given: Float[Tensor, "*batch agent given"],
        hears: Bool[Tensor, "*batch agent"],
    ) -> Float[Tensor, "*batch agent feature"]:
        """Return the features after a step; `hears`: over any live edge, in any round."""
        if self.added is not None:
            after = before + self.added(given)
        else:
            assert self.gate is not None
            gated = self.gate(given.flatten(0, -2), before.flatten(0, -2))
            after = gated.unflatten(0, before.shape[:-1])
        return torch.where(hears.unsqueeze(-1), after, before)
