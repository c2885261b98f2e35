"""`reward=neighbours`: the paper's."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.reward.base import RewardSplit


@final
class Neighbours(RewardSplit):
    """Robots in contact also earn for each other: r_i + sum of r_j over contacts j (paper §3.4).

    Pairwise, not transitive.
    """

    def pay(
        self,
        own_reward: Float[Tensor, "*batch agent 1"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent 1"]:
        return own_reward + (adjacency * own_reward.mT).sum(-1, keepdim=True)
