"""`planner=boustrophedon`: the lawn mower of robotics textbooks, made for unknown houses."""

from typing import final

import torch
from jaxtyping import Int
from torch import Tensor

from marl_clean.planner.base import Known, Sweep


@final
class Boustrophedon(Sweep):
    """Sweeps up and down, column by column to the right, then to the left.

    Each robot steps to the first open neighbour in the order up, down, right, left; with none
    it walks to the nearest open cell and sweeps from there. The order alone makes the sweep: a
    cell that was just left is no longer open.

    Source: the motion of BA*, Viet, Dang, Laskar and Chung, "BA*: an online complete coverage
    algorithm for cleaning robots", Applied Intelligence 39 (2013).
    """

    label = "boustrophedon"

    def order(self, known: Known) -> Int[Tensor, "env agent 4"]:
        up_down_right_left = torch.tensor([0, 2, 1, 3], device=known.cell.device)
        return up_down_right_left.expand(*known.cell.shape, 4)
