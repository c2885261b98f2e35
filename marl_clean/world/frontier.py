"""How far the next cell that needs a visit is, on foot over the known map."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from marl_clean.world.distance import UNREACHABLE, walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import windows_around
from marl_clean.world.shared_map import is_known_dirty, is_known_free, is_unknown
from marl_clean.world.state import State


def steps_to_frontier(state: State, rules: Rules) -> Float[Tensor, "env map height width"]:
    """Return the walking distance from every cell to the nearest unknown or dirty one.

    Over cells known to be available; UNREACHABLE where none leads there, and outside the house
    and its ring. The flood runs over these, and costs them times the longest way.
    """
    ring = rules.margin - 1
    height, width = state.record.shape[-2:]
    record = state.record[..., ring : height - ring, ring : width - ring]
    now = (state.step + 1).to(record.dtype).view(-1, 1, 1, 1)
    height, width = record.shape[-2:]
    own = inside_house(state.rows + 2, state.cols + 2, height, width, margin=0)
    goals = (is_unknown(record) & own[:, None]) | is_known_dirty(record, now, rules)
    distance = walking_distance(is_known_free(record), goals).to(torch.float32)
    return torch.nn.functional.pad(distance, (ring,) * 4, value=float(UNREACHABLE))


def how_much_nearer(
    distance: Float[Tensor, "env map height width"],
    position: Int[Tensor, "env agent 2"],
    view_size: int,
    rules: Rules,
) -> Float[Tensor, "env agent view view"]:
    """Return (d(own cell) - d(cell)) / view_size around each robot, clamped to [-1, 1].

    0 all over for a robot that has nowhere to go.
    """
    around = windows_around(distance, position, view_size, rules.margin)
    middle = view_size // 2
    own = around[..., middle, middle, None, None]
    nearer = ((own - around) / view_size).clamp(-1, 1)
    return torch.where(own < UNREACHABLE, nearer, 0.0)
