"""`observation=frontier`: the paper's square, and a plane of distances to the nearest goal."""

from typing import final

import torch

from marl_clean import keys
from marl_clean.observation.base import Observation
from marl_clean.observation.crop import Crop
from marl_clean.settings import Form, OddInt, Probability
from marl_clean.world.frontier import how_much_nearer, steps_to_frontier
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


@final
class Frontier(Observation):
    """The crop, and how much nearer than the robot each of its cells is to an unvisited goal.

    Adds `("agents", "observation")`, float32 `[*B, n, 2, K, K]`: the crop of the map, and a plane
    in [-1, 1] of (d(robot's own cell) - d(cell)) / K, clamped, where d is the walking distance
    over the known map to the nearest unknown or dirty cell. Where there is no path d is unbounded:
    -1, and 0 everywhere when the robot itself has no path. Other robots block no path.

    With private maps the distances are over each robot's own map. With `position_noise` both
    planes are around the cell that the robot takes for its own, and where the map has a wall there
    the second plane is 0 everywhere.

    Unlike the crop's, its cost grows with the house, not with the view: a flood over every known
    map in each step.

    Args:
        view_size: K, the side of the square in cells, odd.
        position_noise: see `Crop`.
    """

    gives = Form.SQUARES
    spread = staticmethod(Crop.spread)

    def __init__(self, view_size: OddInt = 15, position_noise: Probability = 0.0) -> None:
        super().__init__()
        self.view_size = view_size
        self.crop = Crop(view_size, position_noise)
        self.reach_cells = self.crop.reach_cells

    def shape(self) -> tuple[int, ...]:
        return 2, self.view_size, self.view_size

    def read(self, state: State, setup: Setup) -> Entries:
        crop = self.crop.read(state, setup)[keys.OBSERVATION]
        distance = steps_to_frontier(state, setup.rules)
        centre = self.crop.centre(state, setup)
        plane = how_much_nearer(distance, centre, self.view_size, setup.rules)
        return {keys.OBSERVATION: torch.cat([crop, plane.unsqueeze(2)], 2)}
