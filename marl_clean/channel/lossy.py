"""Messages get lost: each edge for itself, or in bursts."""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from marl_clean import keys
from marl_clean.channel.base import Channel, Dims, Salt, Step
from marl_clean.settings import Probability


@final
class Lossy(Channel):
    """Lose what is sent over an edge in a step with a probability, all its rounds together.

    Each direction of an edge is good or bad, and good as an episode begins:

        good -> bad with probability burst_start,    bad -> good with probability burst_end
        lost with probability loss while good, burst_loss while bad

    With burst_start = 0, losses are independent of each other. A lost message is paid for, and
    no robot notices the loss; the reward does not depend on it.

    Source: E. N. Gilbert, "Capacity of a burst-noise channel" (1960); E. O. Elliott (1963).

    Args:
        loss: probability of a loss in the good state.
        burst_start: probability, each step, that a good edge becomes bad.
        burst_end: probability, each step, that a bad edge becomes good.
        burst_loss: probability of a loss in the bad state.
    """

    draws = True

    def __init__(
        self,
        loss: Probability,
        burst_start: Probability,
        burst_end: Probability,
        burst_loss: Probability,
    ) -> None:
        super().__init__()
        self.loss, self.burst_loss = loss, burst_loss
        self.burst_start, self.burst_end = burst_start, burst_end
        if burst_start > 0:
            self.remembers = keys.BURST

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        drawn = step.uniform_of_edges(Salt.LOSS)
        if step.state is None:
            return message, edges & (drawn >= self.loss)
        lost = torch.where(self.bursts(step), drawn < self.burst_loss, drawn < self.loss)
        return message, edges & ~lost

    def state_spec(self, n_agents: int, message_dims: Dims) -> TensorSpec:
        return Binary(shape=(n_agents, n_agents), dtype=torch.bool)

    def state_after(
        self, step: Step, messages: Sequence[Tensor], edges: Sequence[Tensor]
    ) -> Bool[Tensor, "*batch agent other"]:
        return self.bursts(step)

    def bursts(self, step: Step) -> Bool[Tensor, "*batch agent other"]:
        """Return which edges are bad in this step."""
        assert step.state is not None
        drawn = step.uniform_of_edges(Salt.BURST)
        return torch.where(step.state, drawn >= self.burst_end, drawn < self.burst_start)
