"""`observation=pyramid`: the paper's square, and the same square again at coarser scales."""

from typing import final

import torch

from marl_clean import keys
from marl_clean.observation._map import with_contacts
from marl_clean.observation.base import Observation
from marl_clean.observation.crop import Crop
from marl_clean.settings import Form, OddInt, Probability, Scales
from marl_clean.world.scales import PLANES_A_SCALE, coarser, wide_crop, widest_side
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


@final
class Pyramid(Observation):
    """The crop, and twice, four times ... as large squares of the map around it, ever coarser.

    Adds `("agents", "observation")`, float32 `[*B, n, 1 + 4 (scales - 1), K, K]`: the crop, then
    for s = 1, 2, ... the square of K 2^s x K 2^s cells around the robot as four planes in [0, 1],
    each entry a square of 2^s x 2^s cells: the share of them that is blocked, the share that is
    unknown, their dirt on average (1 - 2 v of an available cell, 0 of others), and whether there
    is a robot. The robot's own cell is in the middle of the middle entry at every scale, so cells
    on the border of two entries count half in each, and rotated views are views of rotated houses.

    They are shares, since an average of the map's codes would mix walls with dirt: averages of the
    planes that the encoder's `planes` makes of the crop, and passed on unchanged by it.

    Its cost is (K 2^(scales - 1))^2 cells a robot, whatever the house: with the defaults some 17
    times the crop's.

    Args:
        view_size: K, the side of every square, odd.
        scales: the number of scales, the crop among them.
        position_noise: see `Crop`; all scales are around the same cell.
    """

    gives = Form.SQUARES
    spread = staticmethod(Crop.spread)

    def __init__(
        self, view_size: OddInt = 15, scales: Scales = 3, position_noise: Probability = 0.0
    ) -> None:
        super().__init__()
        self.view_size = view_size
        self.scales = scales
        self.crop = Crop(view_size, position_noise)
        self.reach_cells = 2  # an edge beyond the ring, which `wide_crop` reads for all outside

    def shape(self) -> tuple[int, ...]:
        return 1 + PLANES_A_SCALE * (self.scales - 1), self.view_size, self.view_size

    def read(self, state: State, setup: Setup) -> Entries:
        centre = self.crop.centre(state, setup)
        side = widest_side(self.view_size, self.scales)
        code = wide_crop(state.record, centre, state.step, side, setup.rules)
        code = with_contacts(code, centre - side // 2, state, setup)
        first = (side - self.view_size) // 2
        middle = slice(first, first + self.view_size)
        planes = coarser(code, self.view_size, self.scales)
        return {keys.OBSERVATION: torch.cat([code[:, :, None, middle, middle], planes], 2)}
