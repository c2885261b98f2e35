"""`planner=random`: the floor under every table."""

from typing import final

from jaxtyping import Int
from torch import Tensor

from marl_clean.planner.base import Planner


@final
class Random(Planner):
    """Each robot takes one of the four actions, uniformly."""

    label = "random"

    def act(self) -> Int[Tensor, "env agent"]:
        return self.random_action()
