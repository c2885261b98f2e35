"""`observation=crop`: the paper's."""

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.settings import Memory, OddInt
from marl_clean.transform import Compile, WorldTransform
from marl_clean.world.rules import BLOCKED_VALUE, ROBOT_VALUE
from marl_clean.world.sensing import crop, mark_contacts
from marl_clean.world.state import State


class Crop(WorldTransform):
    """A robot sees the square of its map around itself, itself in the middle (paper §3.2).

    Adds `("agents", "observation")`, float32 `[*B, n, 1, K, K]` with the map's values: -1 blocked,
    -0.2 unknown, 0 dirty to 0.5 just cleaned, 1 a robot.

    Args:
        view_size: K, the side of the square in cells, odd.
    """

    def __init__(self, view_size: OddInt = 15) -> None:
        super().__init__()
        self.view_size = view_size

    def read(self, state: State, compiled: Compile) -> dict[NestedKey, Tensor]:
        env = self.cleaning
        view = compiled(crop, wide=True)(
            state.record, state.position, state.step, self.view_size, env.rules
        )
        if env.rules.memory is Memory.PRIVATE and env.contact is not None:
            view = compiled(mark_contacts)(view, state.position, env.contact(state, env.rules))
        return {keys.OBSERVATION: view.unsqueeze(2)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        side = self.view_size
        shape = torch.Size([env.num_envs, env.n_agents, 1, side, side])
        return {keys.OBSERVATION: Bounded(BLOCKED_VALUE, ROBOT_VALUE, shape, device=env.device)}
