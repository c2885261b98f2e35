"""Messages are heard some steps after they were sent."""

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import final

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torchrl.data import TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.channel.base import Channel, Dims, Salt, Step
from marl_clean.settings import PositiveInt


def parts_of(message_dims: Dims) -> list[slice]:
    """Return where each round's numbers stand among those of all rounds side by side."""
    ends = list(accumulate(message_dims, initial=0))
    return [slice(start, end) for start, end in pairwise(ends)]


class Later(Channel):
    """Hear in step t what was sent in step t - `steps`, over the edges that were live then.

    Until a message is old enough there is none. What is under way stands in the frame: for each
    sender and age 1 ... steps its message, all rounds side by side, and which robots it reaches in
    each round.
    """

    remembers = keys.OUTBOX

    def __init__(self, steps: int, message_dims: Dims) -> None:
        super().__init__()
        self.steps = self.steps_late = steps
        self.width = sum(message_dims)
        self.parts = parts_of(message_dims)

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        assert step.state is not None
        oldest = step.state[..., -1, :]
        reaches = self.reaches(oldest, round_index)
        return oldest[..., self.parts[round_index]], reaches.mT > 0

    def state_spec(self, n_agents: int, message_dims: Dims) -> TensorSpec:
        return Unbounded(shape=(n_agents, self.steps, self.width + len(self.parts) * n_agents))

    def state_after(
        self, step: Step, messages: Sequence[Tensor], edges: Sequence[Tensor]
    ) -> Float[Tensor, "*batch agent age number"]:
        assert step.state is not None
        reaches = [of_round.mT.to(messages[0].dtype) for of_round in edges]
        newest = torch.cat([*messages, *reaches], dim=-1).unsqueeze(-2)
        return torch.cat([newest, step.state[..., :-1, :]], dim=-2)

    def reaches(
        self, under_way: Float[Tensor, "*batch number"], round_index: int
    ) -> Float[Tensor, "*batch receiver"]:
        """Return which robots a round's message reaches, 1 or 0."""
        by_round = under_way[..., self.width :].unflatten(-1, (len(self.parts), -1))
        return by_round[..., round_index, :]


@final
class Delayed(Later):
    """Hear in step t what was sent in step t - a, over the edges live then, and know a.

        fixed:  a = steps
        random: a is drawn for each sender in each step from 0, 1, ..., steps
        heard:  m_j(t - a) + (a / steps) w

    w is learnt and starts as 0; by it a receiver knows a message's age. Whether there is a message
    at all, it knows by the edge. What is under way is `("agents", "inbox")`.

    Args:
        steps: the age of a message when it is heard, or the most of it.
        random: ages are drawn.
        message_dims: numbers in the message of each round.
    """

    remembers = keys.INBOX

    def __init__(self, steps: PositiveInt, random: bool, message_dims: Dims) -> None:
        super().__init__(steps, message_dims)
        self.draws = random
        self.age = nn.Parameter(torch.zeros(self.width))

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        weight = self.age[self.parts[round_index]]
        if not self.draws:
            heard, edges = super().carry(message, edges, round_index, step)
            return step.unless_silent(heard, heard + weight), edges
        assert step.state is not None
        fresh = torch.cat([message, edges.mT.to(message.dtype)], dim=-1).unsqueeze(-2)
        part, reaches = (
            step.state[..., self.parts[round_index]],
            self.reaches(step.state, round_index),
        )
        every_age = torch.cat([fresh, torch.cat([part, reaches], dim=-1)], dim=-2)
        age = self.ages(step)
        index = age[..., None, None].expand(*age.shape, 1, every_age.shape[-1])
        chosen = every_age.gather(-2, index).squeeze(-2)
        heard, reaches = chosen[..., : len(weight)], chosen[..., len(weight) :]
        marked = heard + (age / self.steps).to(heard.dtype).unsqueeze(-1) * weight
        return step.unless_silent(heard, marked), reaches.mT > 0

    def ages(self, step: Step) -> Int[Tensor, "*batch agent"]:
        """Draw how old the message is that is heard of each robot."""
        zero = torch.zeros(1, dtype=torch.int64, device=self.age.device)
        return (step.bits(Salt.AGE, zero).squeeze(-1) * (self.steps + 1)) >> 32
