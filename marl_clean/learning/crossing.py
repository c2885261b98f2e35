"""How the messages of one step get from who says them to who hears them."""

from collections.abc import Sequence

from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.channel.base import Channel, Step
from marl_clean.comm.base import Delivery


class Crossing(Delivery):
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
        self.steps = [Step(seed, state, gated=gated) for state in states]
        self.sent = adjacency
        for channel in channels:
            self.sent = channel.address(self.sent, distance_rank, rounds)
            self.bits_per_number = channel.bits_per_number or self.bits_per_number

    def __call__(
        self, message: Float[Tensor, "*batch agent message"], turn: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        edges = self.sent
        for channel, step in zip(self.channels, self.steps, strict=True):
            step.passed.append((message, edges))
            message, edges = channel.carry(message, edges, turn, step)
        return message, edges

    def states_after(self) -> list[Tensor]:
        """Return what the channels that carry something carry to the next step, in their order."""
        return [
            channel.state_after(step)
            for channel, step in zip(self.channels, self.steps, strict=True)
            if channel.remembers is not None
        ]


class Repeated(Delivery):
    """Whatever is said now, what was said before goes its way: a replayed frame's messages."""

    def __init__(
        self,
        way: Delivery,
        said: Float[Tensor, "*batch agent message"],
        message_dims: Sequence[int],
    ) -> None:
        self.way, self.sent, self.bits_per_number = way, way.sent, way.bits_per_number
        self.said = said.split(list(message_dims), dim=-1)

    def __call__(
        self, message: Float[Tensor, "*batch agent message"], turn: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return self.way(self.said[turn], turn)
