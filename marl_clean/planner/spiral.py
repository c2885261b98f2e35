"""`planner=spiral`: follows the wall on its left, then its own track, inwards."""

from typing import final

from jaxtyping import Int
from torch import Tensor

from marl_clean.planner.base import Known, Sweep, left_hand_rank


@final
class Spiral(Sweep):
    """Keeps what is done, wall or cleaned cell, on its left: a spiral into every open space.

    Each robot steps to the first open neighbour in the order left, ahead, right and back of the
    direction of its last move (up before its first); with none it walks to the nearest open
    cell and begins a spiral there.

    Source: Gonzalez, Alvarez, Diaz, Parra and Bustacara, "BSA: a complete coverage algorithm",
    ICRA 2005.
    """

    label = "spiral"

    def order(self, known: Known) -> Int[Tensor, "env agent 4"]:
        return left_hand_rank(self.track.heading.clamp(min=0))
