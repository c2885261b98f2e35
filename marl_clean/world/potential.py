"""The potential of reward shaping: minus the walking distance to the nearest goal."""

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.world.distance import walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_known_free, is_known_uncleaned, is_unknown
from marl_clean.world.state import State, cell_index

FARTHEST = 60  # steps; distances are clipped here, unreachable goals included


def potential(state: State, rules: Rules) -> Float[Tensor, "env agent 1"]:
    """Return minus the steps from each robot to the nearest cell that it has to visit.

    The walk is over cells known to be available, to the nearest unknown cell of the house, without
    its ring, or available cell that was never cleaned, by the map that the robot reads. From 0 to
    -FARTHEST, its value where no such cell can be reached. The cost grows with the house.
    """
    ring = rules.margin - 1
    height, width = state.record.shape[-2:]
    record = state.record[..., ring : height - ring, ring : width - ring]
    height, width = record.shape[-2:]
    house = inside_house(state.rows, state.cols, height, width, margin=1)
    goals = (is_unknown(record) & house[:, None]) | is_known_uncleaned(record)
    distance = walking_distance(is_known_free(record), goals).flatten(2)
    cell = cell_index(state.position, 1, width)
    own = distance.expand(-1, state.n_agents, -1).gather(2, cell[..., None])
    return -own.clamp(max=FARTHEST).to(torch.float32)
