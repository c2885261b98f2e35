"""The potential of reward shaping: minus the walking distance to the nearest goal."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from marl_clean.world import searches
from marl_clean.world.distance import walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_known_free, is_known_uncleaned, is_unknown
from marl_clean.world.state import State, cell_index

FARTHEST = 60  # steps; distances are clipped here, unreachable goals included


def potential(state: State, rules: Rules) -> Float[Tensor, "env agent 1"]:
    """Return minus the steps from each robot to the nearest cell that it has to visit.

    The walk is over cells known to be available, to the nearest unknown cell of the house, without
    its ring, or available cell that was never cleaned or is spilt, by the map that the robot reads.
    From 0 to -FARTHEST, its value where no such cell can be reached.
    """
    on_cpu = state.record.device.type == "cpu"
    steps = (by_machine_code if on_cpu else by_tensors)(state, rules)
    return -steps[..., None].clamp(max=FARTHEST).to(torch.float32)


@torch.compiler.disable
def by_machine_code(state: State, rules: Rules) -> Int[Tensor, "env agent"]:
    """Return the steps by a search around each robot, on a CPU: as far as its nearest goal."""
    tensors = (state.record, state.rows, state.cols, state.position)
    record, rows, cols, position = (each.contiguous().numpy() for each in tensors)
    steps = searches.steps_to_goals(record, rules.margin, rows, cols, position, FARTHEST)
    return torch.from_numpy(steps)


def by_tensors(state: State, rules: Rules) -> Int[Tensor, "env agent"]:
    """Return the steps by a flood of the maps, on any device."""
    ring = rules.margin - 1
    height, width = state.record.shape[-2:]
    record = state.record[..., ring : height - ring, ring : width - ring]
    height, width = record.shape[-2:]
    house = inside_house(state.rows, state.cols, height, width, margin=1)
    goals = (is_unknown(record) & house[:, None]) | is_known_uncleaned(record)
    distance = walking_distance(is_known_free(record), goals).flatten(2)
    cell = cell_index(state.position, 1, width)
    own = distance.expand(-1, state.n_agents, -1).gather(2, cell[..., None])
    return own.squeeze(-1)
