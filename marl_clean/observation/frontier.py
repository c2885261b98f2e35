"""`observation=frontier`: the paper's square and a plane that shows where the next dirt is near."""

import torch
from tensordict.utils import NestedKey
from torch import Tensor

from marl_clean import keys
from marl_clean.observation.crop import Crop
from marl_clean.world.frontier import how_much_nearer, steps_to_frontier
from marl_clean.world.state import State


class Frontier(Crop):
    """The crop, and how much nearer than the robot each of its cells is to what needs a visit.

    Adds `("agents", "observation")`, float32 `[*B, n, 2, K, K]`: the crop of the map, and a plane
    in [-1, 1] of (d(robot's own cell) - d(cell)) / K, clamped, where d is the walking distance
    over the known map to the nearest unknown or dirty cell. Where no way leads d is unbounded:
    -1, and 0 all over when the robot itself has nowhere to go. Other robots are in nobody's way.

    With private maps the distances are those over each robot's own. With `position_noise` both
    planes are those around the cell that the robot takes for its own, and where the map holds
    that for a wall the second is 0 all over.

    Unlike the crop this costs the house, not the view: a flood over every known map a step.
    Args and settings are the crop's.
    """

    def shape(self) -> tuple[int, ...]:
        return 2, self.view_size, self.view_size

    def read(self, state: State) -> dict[NestedKey, Tensor]:
        crop = super().read(state)[keys.OBSERVATION]
        distance = steps_to_frontier(state, self.cleaning.rules)
        plane = self.compiled(how_much_nearer, wide=True)(
            distance, self.centre(state), self.view_size, self.cleaning.rules
        )
        return {keys.OBSERVATION: torch.cat([crop, plane.unsqueeze(2)], 2)}
