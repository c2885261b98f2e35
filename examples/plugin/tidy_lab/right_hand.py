"""Robots that keep what is done on their right."""

from jaxtyping import Int
from torch import Tensor

from marl_clean.planner.base import Known, Sweep


class RightHand(Sweep):
    """Steps to the first open neighbour in the order right, ahead, left and back.

    With none open it walks to the nearest open cell, as every sweep does.
    """

    label = "right_hand"

    def order(self, known: Known) -> Int[Tensor, "env agent 4"]:
        heading = self.track.heading.clamp(min=0)
        action = heading.new_tensor(range(4))
        return (heading[..., None] + 1 - action) % 4
