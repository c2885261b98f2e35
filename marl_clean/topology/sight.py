"""`topology=sight`."""

import math
from typing import final

from jaxtyping import Bool
from torch import Tensor

from marl_clean.settings import OddInt, RadiusCells
from marl_clean.topology.base import Topology
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import crossed_cells, in_sight
from marl_clean.world.state import State


@final
class Sight(Topology):
    """Robots talk within a Euclidean distance when no wall stands between them.

    No wall: the open segment between the two centres meets no blocked cell's interior, in the
    true house.

    Args:
        radius_cells: the largest distance between centres, in cells; null: half of the view.
        view_size: side of the square that a robot sees.
    """

    def __init__(self, radius_cells: RadiusCells | None = None, view_size: OddInt = 15) -> None:
        super().__init__()
        self.radius_cells = float(view_size // 2) if radius_cells is None else radius_cells
        self.register_buffer(
            "crossed", crossed_cells(math.floor(self.radius_cells)), persistent=False
        )

    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        return in_sight(state, self.radius_cells, self.crossed, rules)
