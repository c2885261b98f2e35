"""No communication: every robot decides from what it sees itself."""

from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.comm.base import Comm, Width


class Silent(Comm):
    """Return the features unchanged; messages are empty and cost nothing."""

    rounds = 0

    def __init__(self, in_features: Width) -> None:
        super().__init__()
        self.out_features = in_features

    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
    ) -> tuple[
        Float[Tensor, "*batch agent feature"],
        Float[Tensor, "*batch agent 0"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return the features, nothing sent, and 0 bits."""
        return feature, feature[..., :0], feature.new_zeros(*feature.shape[:-1], 1)
