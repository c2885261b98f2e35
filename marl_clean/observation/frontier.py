"""`observation=frontier`: the paper's square and a plane that shows where the next dirt is near."""

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.observation.crop import Crop
from marl_clean.transform import Compile
from marl_clean.world.frontier import how_much_nearer, steps_to_frontier
from marl_clean.world.rules import BLOCKED_VALUE, ROBOT_VALUE
from marl_clean.world.state import State


class Frontier(Crop):
    """The crop, and how much nearer than the robot each of its cells is to what needs a visit.

    Adds `("agents", "observation")`, float32 `[*B, n, 2, K, K]`: the crop of the map, and a plane
    in [-1, 1] of (d(robot's own cell) - d(cell)) / K, clamped, where d is the walking distance
    over the known map to the nearest unknown or dirty cell. Where no way leads d is unbounded:
    -1, and 0 all over when the robot itself has nowhere to go.

    Unlike the crop this costs the house, not the view: a flood over the known map a step.
    """

    def read(self, state: State, compiled: Compile) -> dict[NestedKey, Tensor]:
        crop = super().read(state, compiled)[keys.OBSERVATION]
        distance = steps_to_frontier(state, self.cleaning.rules)
        plane = compiled(how_much_nearer, wide=True)(
            distance, state.position, self.view_size, self.cleaning.rules
        )
        return {keys.OBSERVATION: torch.cat([crop, plane.unsqueeze(2)], 2)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        side = self.view_size
        shape = torch.Size([env.num_envs, env.n_agents, 2, side, side])
        return {keys.OBSERVATION: Bounded(BLOCKED_VALUE, ROBOT_VALUE, shape, device=env.device)}
