"""Potential-based reward shaping, as two transforms: the potential, and the shaping term.

A robot is also paid w (gamma phi' - phi) for the step from a state of potential phi to one of
phi'. Discounted and summed over an episode this is -w phi of its first state, whatever the robot
does, so that optimal policies stay optimal (Ng, Harada and Russell, "Policy invariance under
reward transformations", ICML 1999).
"""

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import RewardTransform, WorldTransform
from marl_clean.world.potential import FARTHEST, potential
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class Potential(WorldTransform):
    """Adds `("agents", "potential")`, float32 `[*B, n, 1]`: phi, see `marl_clean.world.potential`.

    A frame holds it like the adjacency: what a step pays depends on the frame before it.
    """

    def read(self, state: State, setup: Setup) -> Entries:
        return {keys.POTENTIAL: potential(state, setup.rules)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, 1])
        return {keys.POTENTIAL: Bounded(-FARTHEST, 0, shape, device=env.device)}


class Shaping(Transform):
    """Adds w (gamma phi' - phi) to what each robot earns, and then splits the reward.

    phi' is 0 where the episode terminated; at truncation it is kept, since the learner bootstraps
    there. Writes `("agents", "info", "shaping")`, 0 after a reset, and `("agents", "reward")`;
    `own_reward` is left unchanged.

    Attributes:
        gamma: the learner's discount, which training updates where it changes over the run.

    Args:
        split: turns what all robots earn into what each is paid.
        weight: w.
        gamma: the learner's discount at first.
    """

    def __init__(self, split: RewardTransform, weight: float, gamma: float) -> None:
        super().__init__()
        self.split = split
        self.weight = weight
        self.gamma = gamma

    def term(self, before: Tensor, after: Tensor, terminated: Tensor) -> Tensor:
        """Return the shaping term of potentials `[*B, n, 1]`; `terminated` is `[*B, 1]`."""
        after = torch.where(terminated[..., None], 0.0, after)
        return self.weight * (self.gamma * after - before)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        before, after = (td.get(keys.POTENTIAL) for td in (tensordict, next_tensordict))
        term = self.term(before, after, next_tensordict.get(keys.TERMINATED))
        earned = next_tensordict.get(keys.OWN_REWARD) + term
        paid = self.split.pay(earned, tensordict.get(keys.ADJACENCY))
        next_tensordict.set(keys.INFO_SHAPING, term)
        next_tensordict.set(keys.REWARD, paid)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        env = self.container.base_env
        nothing = torch.zeros((env.num_envs, env.n_agents, 1), device=env.device)
        tensordict_reset.set(keys.INFO_SHAPING, nothing)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        env = self.container.base_env
        shape = torch.Size([env.num_envs, env.n_agents, 1])
        observation_spec[keys.INFO_SHAPING] = Unbounded(shape, device=env.device)
        return observation_spec
