"""Where the senders of messages are, seen from those who hear them."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

PLACE = 4  # numbers that say where a sender is
CELLS = 10  # what offsets are divided by


class Senders(NamedTuple):
    """Where the robots that may be heard are, seen from each that may hear them.

    Attributes:
        distance_rank: `[*B, n, n]` int, [i, j]: the rank of j among the others seen from i; 0 is i
            itself, 1 its nearest.
        offset: `[*B, n, n, 2]` float, [i, j]: (row, col) in cells from i to j, 0 over edges that
            are not live or not in contact now; None unless the scheme's `places`.
    """

    distance_rank: Tensor
    offset: Tensor | None = None


def place_of(senders: Senders) -> Float[Tensor, "*batch agent other place"]:
    """Return where each sender is, seen from each hearer: e_ij = (row, col, |row|, |col|) / 10.

    0 over edges that are not live.
    """
    assert senders.offset is not None
    return torch.cat([senders.offset, senders.offset.abs()], dim=-1) / CELLS


def with_places(
    heard: Float[Tensor, "*batch other message"], senders: Senders
) -> Float[Tensor, "*batch agent other message_and_place"]:
    """Return [m_j, e_ij]: each message joined with where its sender is, seen from each hearer."""
    place = place_of(senders)
    spread = heard.unsqueeze(-3).expand(*place.shape[:-1], heard.shape[-1])
    return torch.cat([spread, place], dim=-1)
