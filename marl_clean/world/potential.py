"""How good it is to be where a robot stands: the potential of reward shaping."""

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.world.distance import walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_known_free, is_known_uncleaned, is_unknown
from marl_clean.world.state import State, cell_index

FARTHEST = 60  # steps; nothing farther, or out of reach, is any worse


def potential(state: State, rules: Rules) -> Float[Tensor, "env agent 1"]:
    """Return minus the steps from each robot to the nearest cell that it has to visit.

    On foot over cells known to be available, to the nearest unknown cell of the house, without
    its ring, or available cell that nobody has cleaned; all as the map says that the robot
    reads. From 0 to -FARTHEST, which it is where no such cell can be reached. Costs the house.
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
