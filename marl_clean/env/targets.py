"""Which cell each robot has to clean next, as a transform: for schemes that send it."""

import torch
from tensordict.utils import NestedKey
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries
from marl_clean.world.targets import nearest_targets

FARTHEST = 127  # cells: an offset is a number of 8 bits


class Targets(WorldTransform):
    """Adds `("agents", "target")`, int64 `[*B, n, 3]`: (row, col) from robot to target, and 1.

    The target is the nearest cell on foot that the robot's own map does not know, or knows not to
    be cleaned: where `planner=nearest_unknown` would go in its place. Offsets are clipped to 127
    cells; zeros where no target can be reached.
    """

    def read(self, state: State, setup: Setup) -> Entries:
        place, found = nearest_targets(state, setup.rules)
        offset = (place - state.position).clamp(-FARTHEST, FARTHEST) * found
        return {keys.TARGET: torch.cat([offset, found], dim=-1)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, 3])
        spec = Bounded(-FARTHEST, FARTHEST, shape, device=env.device, dtype=torch.int64)
        return {keys.TARGET: spec}
