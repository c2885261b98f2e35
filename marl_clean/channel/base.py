"""How messages are changed between sender and receiver, whatever the scheme."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import tau

import torch
from jaxtyping import Bool, Float, Int
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec

from marl_clean.world.random import random_bits

Dims = tuple[int, ...]
"""Numbers in the message of each round; handed over by the network's builder."""


class Salt(IntEnum):
    """What a channel draws for; draws for different things are independent."""

    LOSS = 1
    BURST = 2
    AGE = 3
    NOISE = 4
    ORDER = 5


@dataclass(frozen=True)
class Step:
    """What one step brings to a channel, beside the messages.

    Attributes:
        seed: `[*B, n]` int64 in [0, 2^32), a draw for each robot; None where no channel draws.
        state: what the channel remembers of the step before; None where it remembers nothing.
        gated: robots may be silent, and then their message is all zeros.
    """

    seed: Tensor | None
    state: Tensor | None
    gated: bool = False

    def bits(self, salt: Salt, *words: int | Tensor) -> Int[Tensor, "*batch agent n"]:
        """Return draws in [0, 2^32) for each robot and each of the words, which broadcast."""
        assert self.seed is not None
        return random_bits(int(salt), self.seed.unsqueeze(-1), *words)

    def uniform(
        self, salt: Salt, count: int, round_index: int = 0
    ) -> Float[Tensor, "*batch agent n"]:
        """Return `count` numbers in (0, 1) for each robot: a function of its seed alone."""
        assert self.seed is not None
        index = torch.arange(count, device=self.seed.device)
        return _to_unit(self.bits(salt, round_index, index))

    def uniform_of_edges(self, salt: Salt) -> Float[Tensor, "*batch agent other"]:
        """Return a number in (0, 1) for each [i, j]: a function of the seeds of i and of j.

        So no draw depends on how the robots are numbered, and [j, i] is a draw of its own.
        """
        assert self.seed is not None
        return _to_unit(self.bits(salt, self.seed.unsqueeze(-2)))

    def normal(
        self, salt: Salt, count: int, round_index: int = 0
    ) -> Float[Tensor, "*batch agent n"]:
        """Return `count` standard normal numbers for each robot (Box and Muller, 1958)."""
        first, second = self.uniform(salt, 2 * count, round_index).chunk(2, dim=-1)
        return (-2 * first.log()).sqrt() * (tau * second).cos()

    def unless_silent(
        self,
        sent: Float[Tensor, "*batch agent message"],
        heard: Float[Tensor, "*batch agent message"],
    ) -> Float[Tensor, "*batch agent message"]:
        """Return what is heard; of a robot that chose to be silent nothing, not even noise.

        Its zeros stay as they were sent, for by their gradient a gate learns where it is shut.
        """
        if not self.gated:
            return heard
        return torch.where(sent.ne(0).any(-1, keepdim=True), heard, sent)


def _to_unit(bits: Int[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Return bits in [0, 2^32) as numbers in (0, 1), so a probability of 0 or 1 is exact."""
    return ((bits >> 9).float() + 0.5) / 2**23


class Channel(nn.Module):
    """One transformation of messages between being sent and being heard; this one does nothing.

    Channels stack: what one lets through comes to the next. Draws are functions of the seeds that
    came with the observation, so a replayed frame loses the very messages that it lost, and how
    many worlds are played at once changes nothing.

    Attributes:
        draws: it needs seeds.
        bits_per_number: what a number costs over this channel; None: as it came.
        remembers: where what it carries from step to step stands in a frame; None: nowhere.
        steps_late: after how many steps its messages may be heard, so many do gradients go back.
    """

    draws: bool = False
    bits_per_number: int | None = None
    remembers: NestedKey | None = None
    steps_late: int = 0

    def address(
        self,
        edges: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
        rounds: int,
    ) -> Bool[Tensor, "*batch agent other"]:
        """Return over which of the edges anything is sent at all; [i, j]: from j to i."""
        return edges

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        """Return what is heard of a round's messages, and over which edges."""
        return message, edges

    def state_spec(self, n_agents: int, message_dims: Dims) -> TensorSpec:
        """Return the spec of what it carries, without batch; an episode starts with zeros."""
        raise NotImplementedError(f"{type(self).__name__} carries nothing")

    def state_after(
        self, step: Step, messages: Sequence[Tensor], edges: Sequence[Tensor]
    ) -> Tensor:
        """Return what it carries to the next step.

        `messages` and `edges` are what reached this channel in this step, an entry for each round.
        """
        raise NotImplementedError(f"{type(self).__name__} carries nothing")
