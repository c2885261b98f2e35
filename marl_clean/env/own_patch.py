"""What robots know by themselves of the cells around them, for schemes that send it."""

import torch
from tensordict.utils import NestedKey
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.patches import CLEANED, SIDE, UNKNOWN, own_patches
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class OwnPatch(WorldTransform):
    """Adds `("agents", "patch")`, int8 `[*B, n, 49]`: the 7 x 7 cells around a robot, row by row.

    By its own map, without what it has heard: 0 unknown, 1 blocked, 2 available and not cleaned in
    this episode, 3 cleaned.
    """

    def read(self, state: State, setup: Setup) -> Entries:
        return {keys.PATCH: own_patches(state, setup.rules.margin)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, SIDE**2])
        return {keys.PATCH: Bounded(UNKNOWN, CLEANED, shape, device=env.device, dtype=torch.int8)}
