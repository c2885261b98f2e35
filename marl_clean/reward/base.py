"""How what the robots earn is split into what each is paid (paper §3.4)."""

from abc import abstractmethod

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.env.transform import RewardTransform


class RewardSplit(RewardTransform):
    """Writes `("next", "agents", "reward")` `[*B, n, 1]`, from each robot's `own_reward`.

    A pure function of what the robots earned in a step and of which were in contact when the
    actions were chosen, whether or not messages arrive. It is compiled into one call with the step.
    """

    @abstractmethod
    def pay(
        self,
        own_reward: Float[Tensor, "*batch agent 1"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent 1"]:
        """Return what each robot is paid, a new tensor of the shape of `own_reward`."""
