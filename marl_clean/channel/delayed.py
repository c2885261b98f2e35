"""Messages are heard some steps after they were sent."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torchrl.data import TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.channel.base import Channel, Dims, Salt, Step
from marl_clean.settings import PositiveInt


class Later(Channel):
    """Hear in step t what was sent in step t - `steps`, by who could be reached then.

    Until a message is old enough there is none. What is under way stands in the frame: for each
    sender and age 1 ... steps its message, all rounds side by side, and which robots it reaches.
    """

    remembers = keys.OUTBOX

    def __init__(self, steps: int, message_dims: Dims) -> None:
        super().__init__()
        self.steps = self.steps_late = steps
        self.words = sum(message_dims)
        starts = [sum(message_dims[:turn]) for turn in range(len(message_dims))]
        self.parts = [slice(a, a + b) for a, b in zip(starts, message_dims, strict=True)]

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        turn: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        assert step.state is not None
        oldest = step.state[..., -1, :]
        return oldest[..., self.parts[turn]], oldest[..., self.words :].mT > 0

    def state_spec(self, n_agents: int, message_dims: Dims) -> TensorSpec:
        return Unbounded(shape=(n_agents, self.steps, self.words + n_agents))

    def state_after(self, step: Step) -> Float[Tensor, "*batch agent age number"]:
        assert step.state is not None
        messages = [message for message, _ in step.passed]
        reaches = step.passed[0][1].mT.to(messages[0].dtype)
        newest = torch.cat([*messages, reaches], dim=-1).unsqueeze(-2)
        return torch.cat([newest, step.state[..., :-1, :]], dim=-2)


class Delayed(Later):
    """Hear in step t what was sent in step t - a, by who could be reached then, and know a.

        fixed:  a = steps
        random: a is drawn for each sender in each step from 0, 1, ..., steps
        heard:  m_j(t - a) + (a / steps) w

    w is learnt and starts as 0; by it a hearer is told a message's age. Whether there is a message
    at all is told by the edge. What is under way is `("agents", "inbox")`.

    Args:
        steps: the age of a message when it is heard, or the most of it.
        random: ages are drawn.
        message_dims: numbers in the message of each round.
    """

    remembers = keys.INBOX

    def __init__(self, steps: PositiveInt, random: bool, message_dims: Dims) -> None:
        super().__init__(steps, message_dims)
        self.draws = random
        self.age = nn.Parameter(torch.zeros(self.words))

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        turn: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        weight = self.age[self.parts[turn]]
        if not self.draws:
            heard, edges = super().carry(message, edges, turn, step)
            return step.unless_silent(heard, heard + weight), edges
        assert step.state is not None
        fresh = torch.cat([message, edges.mT.to(message.dtype)], dim=-1).unsqueeze(-2)
        part, reaches = step.state[..., self.parts[turn]], step.state[..., self.words :]
        every_age = torch.cat([fresh, torch.cat([part, reaches], dim=-1)], dim=-2)
        age = self.ages(step)
        index = age[..., None, None].expand(*age.shape, 1, every_age.shape[-1])
        chosen = every_age.gather(-2, index).squeeze(-2)
        heard, reaches = chosen[..., : len(weight)], chosen[..., len(weight) :]
        told = heard + (age / self.steps).to(heard.dtype).unsqueeze(-1) * weight
        return step.unless_silent(heard, told), reaches.mT > 0

    def ages(self, step: Step) -> Int[Tensor, "*batch agent"]:
        """Draw how old the message is that is heard of each robot."""
        zero = torch.zeros(1, dtype=torch.int64, device=self.age.device)
        return (step.bits(Salt.AGE, zero).squeeze(-1) * (self.steps + 1)) >> 32
