"""`observation=distances`: the paper's alternative, sensors instead of memory."""

from typing import final

import torch

from marl_clean import keys
from marl_clean.observation.base import Observation
from marl_clean.settings import Form, RangeCells
from marl_clean.world.sensing import free_run
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries

COMPASS = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
"""North (up), north-east, east and on around, as changes of (row, col)."""


@final
class Distances(Observation):
    """A robot senses how far the nearest obstacle is in eight directions (paper §3.2).

    Adds `("agents", "observation")`, float32 `[*B, n, 8]` for N, NE, E, SE, S, SW, W, NW: the free
    cells between the robot's own and the first blocked one in this direction, in the true house,
    divided by the sensor's reach: 0 when the neighbour is blocked, 1 when no obstacle is within
    reach. Diagonal cells are counted like others, and a ray passes between two corners. Robots are
    not obstacles. The map is not seen at all: a robot does not know where it has been.

    Args:
        range_cells: the sensors' reach in cells; the cost grows with it.
    """

    gives = Form.VECTOR
    lowest = 0.0
    along = True

    def __init__(self, range_cells: RangeCells = 15) -> None:
        super().__init__()
        self.range_cells = range_cells
        self.register_buffer("compass", torch.tensor(COMPASS), persistent=False)

    def shape(self) -> tuple[int, ...]:
        return (len(COMPASS),)

    def read(self, state: State, setup: Setup) -> Entries:
        cells = free_run(state.blocked, state.position, self.compass, self.range_cells, setup.rules)
        return {keys.OBSERVATION: cells.to(torch.float32) / self.range_cells}
