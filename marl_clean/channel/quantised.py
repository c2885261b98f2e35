"""Numbers cross in a few bits each."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.channel.base import Channel, Step
from marl_clean.settings import BitsPerNumber, PositiveFloat


@final
class Quantised(Channel):
    """Send each number as the nearest of 2^b levels between -limit and limit.

        level = round((clamp(m) + limit) / width),    width = 2 limit / (2^b - 1)
        heard = level width - limit

    Gradients pass as if nothing were rounded (straight-through, arXiv 1308.3432); beyond the
    limits there is none. A number costs b bits; what a scheme sends in bits already, such as dial,
    costs no less for it.

    Args:
        bits: b.
        limit: the largest number that crosses.
    """

    def __init__(self, bits: BitsPerNumber, limit: PositiveFloat) -> None:
        super().__init__()
        self.bits_per_number, self.limit = bits, limit

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        assert self.bits_per_number is not None
        width = 2 * self.limit / (2**self.bits_per_number - 1)
        kept = message.clamp(-self.limit, self.limit)
        rounded = ((kept + self.limit) / width).round() * width - self.limit
        # What is added is 0: with `kept` itself in the sum, its last digits would be heard too.
        heard = rounded.detach() + (kept - kept.detach())
        return step.unless_silent(message, heard), edges
