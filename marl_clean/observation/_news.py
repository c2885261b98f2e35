"""What the maps of robots in contact hold and one's own does not."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.observation._compass import BLOCK_CELLS, BLOCKS
from marl_clean.settings import Memory
from marl_clean.world.sensing import windows_around
from marl_clean.world.setup import Setup
from marl_clean.world.shared_map import is_unknown
from marl_clean.world.state import State
from marl_clean.world.surroundings import block_shares


def news_numbers(view_size: int) -> int:
    return view_size**2 + len(BLOCK_CELLS) * BLOCKS**2


def news_around(
    state: State, setup: Setup, centre: Int[Tensor, "env agent 2"], view_size: int
) -> Float[Tensor, "env agent number"]:
    """Return where around each robot there is news: cells in a square, then shares of blocks."""
    news = cells_with_news(state, setup)
    ring = setup.rules.margin - 1
    height, width = news.shape[-2:]
    inner = news[..., ring : height - ring, ring : width - ring]
    square = windows_around(news.float(), centre, view_size, setup.rules.margin)
    blocks = [block_shares(inner, centre + 1, side) for side in BLOCK_CELLS]
    return torch.cat([part.flatten(2) for part in (square, *blocks)], -1)


def cells_with_news(state: State, setup: Setup) -> Bool[Tensor, "env agent height width"]:
    """Tell of which cells some robot in contact knows what a robot itself does not."""
    known = ~is_unknown(state.record)
    if setup.rules.memory is Memory.SHARED or setup.contact is None:
        return torch.zeros_like(known).expand(-1, state.n_agents, -1, -1)
    contact = setup.contact(state, setup.rules).float()
    of_contacts = (contact @ known.flatten(2).float()).view(known.shape) > 0
    return of_contacts & ~known
