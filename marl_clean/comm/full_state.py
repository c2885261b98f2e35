"""The paper's first option: robots in contact share all that they see (§3.4)."""

from typing import Literal, final

from jaxtyping import Float
from torch import Tensor, nn

from marl_clean.comm._joining import Joining
from marl_clean.comm.base import Hearing, Width, outgoing
from marl_clean.settings import LayerWidth, PositiveInt


@final
class FullState(Joining):
    """Robots in contact share their whole observation: no bottleneck, an upper bound.

        r_ij = relu(W_r [h_j, e_ij])              j's observation, through the same encoder
        ordered: c_i = [r_ij of i's nearest live edge, of the next, ..., 0 for an empty slot]
        sum:     c_i = sum over live edges of r_ij
        h'_i = relu(W [relu(W_o h_i), c_i])

    e_ij says where j is, with `places`; it is left out without.

    All robots share the encoder, so the message is computed as its feature h_j; what would be
    sent is the observation, and the bits are those of its numbers.

    Source: paper §3.4, first option.

    Args:
        in_features: length of the encoder's features.
        observed: numbers in one robot's observation.
        hidden: width of the own block and of the joined layer.
        received: width of the block each neighbour's features go through.
        combine: `ordered` takes up to `max_neighbours`, nearest first; `sum` any number.
        max_neighbours: slots of `ordered`; further neighbours are not heard.
        detach: a receiver's loss does not reach what the encoder makes of the sender's.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        observed: Width,
        hidden: LayerWidth,
        received: LayerWidth,
        combine: Literal["ordered", "sum"],
        max_neighbours: PositiveInt,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__(
            nn.Identity(),
            in_features,
            in_features,
            hidden,
            received,
            combine,
            max_neighbours,
            hearing,
        )
        self.observed, self.detach = observed, detach

    def numbers(self, round_index: int) -> int:
        return self.observed

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent feature"]:
        return outgoing(state, self.detach)
