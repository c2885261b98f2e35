"""Where each robot is, seen from each other, as a transform: for schemes that use places."""

import torch
from tensordict.utils import NestedKey
from torchrl.data import TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.sensing import offsets
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class Offsets(WorldTransform):
    """Adds `("agents", "offset")`, int64 `[*B, n, n, 2]`: at [i, j] (row, col) from i to j.

    Of all pairs; `marl_clean.comm.base.Comm` lets a scheme see those over live edges alone.
    """

    along = True

    def read(self, state: State, setup: Setup) -> Entries:
        return {keys.OFFSET: offsets(state.position)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, env.n_agents, 2])
        return {keys.OFFSET: Unbounded(shape, device=env.device, dtype=torch.int64)}
