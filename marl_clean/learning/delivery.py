"""How the messages of one step get from their senders to their receivers."""

from collections.abc import Sequence

from jaxtyping import Bool, Float, Int
from tensordict.utils import NestedKey
from torch import Tensor

from marl_clean.channel.base import Channel, Step
from marl_clean.comm.base import Delivery
from marl_clean.errors import BadInput


def state_keys(channels: Sequence[Channel], names: Sequence[str]) -> tuple[NestedKey, ...]:
    """Return the keys by which the channels of a stack remember, in their order.

    Raises:
        BadInput: two of them remember by one key, and would overwrite each other's state.
    """
    owners: dict[NestedKey, str] = {}
    for channel, name in zip(channels, names, strict=True):
        key = channel.remembers
        if key is not None and key in owners:
            raise BadInput(
                f"channel={name}: remembers by {key}, as {owners[key]} does, and overwrites"
                " its state; valid: one channel for each key, or another key in `remembers`"
            )
        if key is not None:
            owners[key] = name
    return tuple(owners)


class Stacked(Delivery):
    """One step through a stack of channels, the first nearest to the sender."""

    def __init__(
        self,
        channels: Sequence[Channel],
        adjacency: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
        rounds: int,
        seed: Int[Tensor, "*batch agent"] | None,
        states: Sequence[Tensor | None],
        gated: bool = False,
    ) -> None:
        self.channels = channels
        self.steps = [Step(seed, state, gated) for state in states]
        self.messages: list[list[Tensor]] = [[] for _ in channels]  # what reached each, by round
        self.edges: list[list[Tensor]] = [[] for _ in channels]
        self.sent = adjacency
        for channel in channels:
            self.sent = channel.address(self.sent, distance_rank, rounds)
            self.bits_per_number = channel.bits_per_number or self.bits_per_number

    def __call__(
        self,
        message: Float[Tensor, "*batch agent message"],
        round_index: int,
        chosen: Bool[Tensor, "*batch agent other"] | None = None,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        edges = self.sent if chosen is None else self.sent & chosen
        for index, channel in enumerate(self.channels):
            self.messages[index].append(message)
            self.edges[index].append(edges)
            message, edges = channel.carry(message, edges, round_index, self.steps[index])
        return message, edges

    def states_after(self) -> dict[NestedKey, Tensor]:
        """Return what channels carry to the next step, each under the key that it remembers by."""
        inputs = zip(self.channels, self.steps, self.messages, self.edges, strict=True)
        return {
            channel.remembers: channel.state_after(step, messages, edges)
            for channel, step, messages, edges in inputs
            if channel.remembers is not None
        }


class Repeated(Delivery):
    """Deliver messages sent before, whatever is sent now: those of a replayed frame."""

    def __init__(
        self,
        delivery: Delivery,
        message: Float[Tensor, "*batch agent message"],
        message_dims: Sequence[int],
    ) -> None:
        self.delivery, self.sent = delivery, delivery.sent
        self.bits_per_number = delivery.bits_per_number
        self.messages = message.split(list(message_dims), dim=-1)

    def __call__(
        self,
        message: Float[Tensor, "*batch agent message"],
        round_index: int,
        chosen: Bool[Tensor, "*batch agent other"] | None = None,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return self.delivery(self.messages[round_index], round_index, chosen)
