"""DIAL: robots exchange bits, learnt through a noisy sigmoid, heard a step later."""

from typing import Literal, final

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.comm._joining import Joining, message_layers
from marl_clean.comm.base import Hearing, NoisyWhileLearning, Width
from marl_clean.settings import LayerWidth, NonNegativeFloat, PositiveInt


class Bits(NoisyWhileLearning):
    """Say bits: sigmoid(a + std z) while learning, z standard normal; 1 if a > 0, else 0, in use.

    The noise pushes a away from 0, so that little is lost when it becomes a bit.
    """

    def __init__(self, noise_std: float) -> None:
        super().__init__()
        self.noise_std = noise_std

    def forward(self, logit: Float[Tensor, "*batch bit"]) -> Float[Tensor, "*batch bit"]:
        if self.training:
            return (logit + self.noise_std * torch.randn_like(logit)).sigmoid()
        return (logit > 0).to(logit.dtype)


@final
class Dial(Joining):
    """Send bits by the discretise-or-regularise unit, heard in the next step.

        a_j = message(h_j)
        m_j = sigmoid(a_j + std z)  while learning,    1 if a_j > 0, else 0  in use
        what is heard of m_j(t - 1) is joined as in `marl_clean.comm.plan.Plan`

    Gradients reach the sender a step back, within the frames in a row that are learnt from.

    Source: arXiv 1605.06676, whose text cuts a bit at 0.5: of a that would not be the middle of
    the sigmoid. There a robot remembers by a GRU, here too if `encoder.memory=gru`.

    Args:
        in_features: length of the encoder's features.
        message_dim: bits in a message.
        hidden: width of the own block and of the joined layer.
        received: width of the block each received message goes through.
        combine: `ordered` takes up to `max_neighbours`, nearest first; `sum` any number.
        max_neighbours: slots of `ordered`; further neighbours are not heard.
        noise_std: standard deviation of the noise while learning.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    bits_per_number = 1
    delay_steps = 1

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        hidden: LayerWidth,
        received: LayerWidth,
        combine: Literal["ordered", "sum"],
        max_neighbours: PositiveInt,
        noise_std: NonNegativeFloat,
        hearing: Hearing = Hearing(),
    ) -> None:
        message = message_layers(in_features, hidden, message_dim)
        super().__init__(
            message, in_features, message_dim, hidden, received, combine, max_neighbours, hearing
        )
        self.bits = Bits(noise_std)

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return self.bits(super().speak(state, round_index))
