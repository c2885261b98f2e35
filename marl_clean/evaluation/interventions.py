"""What if messages were different? Changes to a trained policy's messages, behind its channel.

Each is a channel nearest to the receiver: what is sent, and what it costs, is unchanged. They are
not for training. Source of the question: arXiv 1903.05168.
"""

import copy
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torchrl.data import TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.channel.base import Channel, Dims, Salt, Step
from marl_clean.channel.delayed import Later, parts_of
from marl_clean.channel.self_send import SelfSend
from marl_clean.config.schema import choices
from marl_clean.errors import BadInput
from marl_clean.learning.acting import Greedy

Message = Float[Tensor, "*batch agent message"]
Edges = Bool[Tensor, "*batch agent other"]


class Zero(Channel):
    """Hear zeros, over the same edges."""

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        return torch.zeros_like(message), edges


class Shuffle(Channel):
    """Hear another robot's message of the same step, from this world or another.

    The robots of all running episodes are put in a random order, drawn in each step, and a robot's
    message is replaced by that of the robot `shift` places later; never by its own, where there is
    another.
    """

    draws = True

    def __init__(self, shift: int = 1) -> None:
        super().__init__()
        self.shift = shift

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        words = torch.zeros(1, dtype=torch.int64, device=message.device)
        order = step.bits(Salt.ORDER, words).flatten().argsort()
        shift = 1 + (self.shift - 1) % max(1, len(order) - 1)
        others = torch.empty_like(order)
        others[order] = order.roll(-shift)
        return message.flatten(0, -2)[others].view_as(message), edges


class Freeze(Channel):
    """Hear from each robot what it sent in the first step of the episode."""

    remembers = keys.FROZEN

    def __init__(self, message_dims: Dims) -> None:
        super().__init__()
        self.parts = parts_of(message_dims)

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        assert step.state is not None
        first = step.state[..., self.parts[round_index]]
        return torch.where(step.state[..., -1:] > 0, first, message), edges

    def state_spec(self, n_agents: int, message_dims: Dims) -> TensorSpec:
        return Unbounded(shape=(n_agents, sum(message_dims) + 1))

    def state_after(
        self, step: Step, messages: Sequence[Tensor], edges: Sequence[Tensor]
    ) -> Tensor:
        assert step.state is not None
        is_frozen = torch.ones_like(messages[0][..., :1])
        now = torch.cat([*messages, is_frozen], dim=-1)
        return torch.where(step.state[..., -1:] > 0, step.state, now)


class Noise(Channel):
    """Hear each number with Gaussian noise, whose std is that of the number over robots now.

    A robot that chose to be silent is not heard, and neither is any noise.
    """

    draws = True

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        std = message.flatten(0, -2).std(0, correction=0)
        noise = step.normal(Salt.NOISE, message.shape[-1], round_index)
        return step.unless_silent(message, message + std * noise.to(message.dtype)), edges


class Mean(Channel):
    """Hear the mean message of the robots of all running episodes, over the same edges.

    Unlike zeros it lies where messages lie; who is in contact is all that is left of it.
    """

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        return message.flatten(0, -2).mean(0).expand_as(message), edges


class Late(Later):
    """Hear every message one step later."""

    remembers = keys.LATE


class Open(Channel):
    """Hear all robots, in contact or not."""

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        itself = torch.eye(edges.shape[-1], dtype=torch.bool, device=edges.device)
        return message, (~itself).expand(edges.shape)


class Shut(Channel):
    """Hear no robot."""

    def carry(
        self, message: Message, edges: Edges, round_index: int, step: Step
    ) -> tuple[Message, Edges]:
        return message, torch.zeros_like(edges)


INTERVENTIONS: dict[str, Callable[[Dims], Channel]] = {
    "zero": lambda dims: Zero(),
    "shuffle": lambda dims: Shuffle(),
    "constant": lambda dims: Mean(),
    "self_send": lambda dims: SelfSend(),
    "freeze": Freeze,
    "noise": lambda dims: Noise(),
    "delay": lambda dims: Late(1, dims),
    "open": lambda dims: Open(),
    "shut": lambda dims: Shut(),
}


def named(text: str) -> list[str]:
    """The interventions that `zero,shut` or `all` names. Raises BadInput on others."""
    names = [name.strip() for name in text.strip("[]").split(",")]
    if names == ["all"]:
        return list(INTERVENTIONS)
    for name in names:
        if name not in INTERVENTIONS:
            valid = choices(name, [*INTERVENTIONS, "all"])
            raise BadInput(f"intervention={name}: no such intervention; {valid}")
    return list(dict.fromkeys(names))


def communicating(policy: nn.Module, name: str) -> Greedy:
    """The policy itself. Raises BadInput where its robots send no messages."""
    if not isinstance(policy, Greedy) or policy.network.comm.rounds == 0:
        raise BadInput(
            f"checkpoint={name}: its robots send no messages, so there is nothing to change"
        )
    return policy


def intervened(policy: Greedy, channel: Callable[[Dims], Channel]) -> Greedy:
    """The same policy, with one more channel before each receiver."""
    network = copy.deepcopy(policy.network)
    network.put_behind(channel(tuple(network.comm.message_dims)))
    return Greedy(network, policy.n_agents, records_messages=True).eval()
