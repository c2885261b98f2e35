"""The draws of channels, as a transform: frames hold them, so that a replay repeats them."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Bounded, Composite
from torchrl.envs import Transform

from marl_clean import keys
from marl_clean.env.base import BatchedEnv
from marl_clean.world.random import Purpose


class ChannelSeed(Transform):
    """Adds `("agents", "channel_seed")`, int64 `[*B, n]`: a draw for each robot and step."""

    @property
    def batched_env(self) -> BatchedEnv:
        """The env that draws."""
        return self.container.base_env

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict.set(keys.CHANNEL_SEED, self.batched_env.draw(Purpose.CHANNEL))
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        tensordict_reset.set(keys.CHANNEL_SEED, self.batched_env.draw(Purpose.CHANNEL))
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        env = self.batched_env
        shape = (env.num_envs, env.n_agents)
        spec = Bounded(0, 2**32 - 1, shape=shape, dtype=torch.int64, device=env.device)
        observation_spec[keys.CHANNEL_SEED] = spec
        return observation_spec
