"""Who is paid what a robot earns, as a transform (paper §3.4)."""

from abc import abstractmethod

from jaxtyping import Bool, Float
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from marl_clean import keys


class RewardSplit(Transform):
    """Adds what each robot is paid, `("next", "agents", "reward")` `[*B, n, 1]`.

    Contact is that of the moment when the actions were chosen, whatever becomes of the messages.
    """

    @abstractmethod
    def pay(
        self,
        own_reward: Float[Tensor, "*batch agent 1"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent 1"]:
        """Return what each robot is paid."""

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        own_reward = next_tensordict.get(keys.OWN_REWARD)
        paid = self.pay(own_reward, tensordict.get(keys.ADJACENCY))
        next_tensordict.set(keys.REWARD, paid)
        return next_tensordict

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        reward_spec[keys.REWARD] = reward_spec[keys.OWN_REWARD].clone()
        return reward_spec
