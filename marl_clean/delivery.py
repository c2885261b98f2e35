"""How the messages of one step get to who hears them: what a scheme asks of what is below it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from jaxtyping import Bool, Float
from torch import Tensor


class Delivery(ABC):
    """One step's way of all messages.

    Attributes:
        sent: `[*B, n, n]` bool, [i, j]: j sends to i, and pays for it, heard or not.
        bits_per_number: what a number costs on this way; None: as the scheme makes it.
    """

    sent: Tensor
    bits_per_number: int | None = None

    @abstractmethod
    def __call__(
        self, message: Float[Tensor, "*batch agent message"], turn: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        """Send the messages of round `turn`; return those heard now, and [i, j]: i hears j's."""


class Direct(Delivery):
    """Everything arrives at once, as it was sent, over every live edge."""

    def __init__(self, adjacency: Bool[Tensor, "*batch agent other"]) -> None:
        self.sent = adjacency

    def __call__(
        self, message: Float[Tensor, "*batch agent message"], turn: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return message, self.sent


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
