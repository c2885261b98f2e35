"""A control: every message is the same."""

from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.channel.base import Channel, Step
from marl_clean.settings import FiniteFloat


@final
class Constant(Channel):
    """Hear `value` in the place of every number, over the same edges.

    A robot learns who is in contact, and nothing else; with 0 it is the zeroed twin of any scheme.
    A robot that chose to be silent is not heard: its zeros stay.

    Args:
        value: what is heard.

    Source: our control.
    """

    def __init__(self, value: FiniteFloat) -> None:
        super().__init__()
        self.value = value

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return step.unless_silent(message, torch.full_like(message, self.value)), edges
