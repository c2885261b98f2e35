"""What every communication scheme takes and gives."""

from abc import ABC, abstractmethod

from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

Width = int
"""Length of a feature vector; handed over by the network's builder, so never a config key."""

BITS_PER_FLOAT = 32


class Comm(nn.Module, ABC):
    """Turn features of robots and who may talk to whom into features that know of each other.

    A robot sends its message to each of its live edges, so its bits in a step are
    32 x length of the message x its live edges, whether or not the receiver makes use of it.
    Results depend on live edges only, and not on how the robots are numbered.
    """

    out_features: int

    @abstractmethod
    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
    ) -> tuple[
        Float[Tensor, "*batch agent joined"],
        Float[Tensor, "*batch agent message"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return the new features, the messages sent, and what sending them cost in bits.

        `distance_rank` [i, j] is the rank of j among the others seen from i: 0 is i itself, 1
        its nearest.
        """
