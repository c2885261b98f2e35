"""`reward=individual`."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.reward.base import RewardSplit


@final
class Individual(RewardSplit):
    """Each robot is paid what it earns itself."""

    def pay(
        self,
        own_reward: Float[Tensor, "*batch agent 1"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent 1"]:
        return own_reward.clone()
