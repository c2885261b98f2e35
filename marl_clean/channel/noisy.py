"""Noise is added to every number."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.channel.base import Channel, Salt, Step
from marl_clean.settings import PositiveFloat


@final
class Noisy(Channel):
    """Add Gaussian noise to what is heard: m + std z, z standard normal.

    One draw for each number that a robot sends, the same for all that hear it. Noise passes
    gradients on as they are.

    Args:
        std: standard deviation; messages of `tanh` lie in [-1, 1], others have no limit.
    """

    draws = True

    def __init__(self, std: PositiveFloat) -> None:
        super().__init__()
        self.std = std

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        noise = step.normal(Salt.NOISE, message.shape[-1], round_index)
        return step.unless_silent(message, message + self.std * noise.to(message.dtype)), edges
