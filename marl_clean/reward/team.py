"""`reward=team`: the central controller's."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.reward.base import RewardSplit


@final
class Team(RewardSplit):
    """Every robot is paid the sum of what all earn (paper §3.4, approach 1)."""

    def pay(
        self,
        own_reward: Float[Tensor, "*batch agent 1"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent 1"]:
        return own_reward.sum(-2, keepdim=True).expand_as(own_reward).clone()
