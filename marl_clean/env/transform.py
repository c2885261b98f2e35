"""What transforms share: those that read the world, and those that pay for what is done in it."""

from abc import abstractmethod
from collections.abc import Callable

from jaxtyping import Bool, Float
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.world.state import State
from marl_clean.world.turn import Reader


class WorldTransform(Transform):
    """Adds keys that are computed from the state of a `CleaningEnv`.

    The state is read by reference, from the env itself: a map published as a key would be copied
    at every partial reset and recorded at every step of a rollout. After a partial reset only
    the worlds that were reset are computed.
    """

    @property
    def cleaning(self) -> CleaningEnv:
        """The env whose state is read."""
        return self.container.base_env

    def reader(self, *, few: bool = False) -> Reader | None:
        """Return what `read` does, where that is one function to be compiled with a step.

        That asks for short loops; with `few` worlds, those that begin, it does not.
        """
        return None

    @abstractmethod
    def read(self, state: State) -> dict[NestedKey, Tensor]:
        """Compute the entries for all worlds of `state`, pure functions by `compiled`."""

    def compiled(self, function: Callable, *, wide: bool = False) -> Callable:
        """Return the function compiled, where the env is; see `Compiling.compiled`."""
        return self.cleaning.compiled(function, wide=wide)

    @abstractmethod
    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        """Return the spec of every entry that `read` gives."""

    def env_index_of(self, state: State) -> Tensor:
        """The indices of the worlds in `state`, as `read` gets it: all, or those that reset."""
        env = self.cleaning
        return env.env_index if state is env.state else env.env_index[env.reset_rows]

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key, value in self.read(self.cleaning.state).items():
            next_tensordict.set(key, value)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        env = self.cleaning
        if len(env.reset_rows) == env.num_envs:
            entries = self.read(env.state)
        else:
            rows, all_envs = env.reset_rows, env.num_envs
            entries = {k: _spread(v, rows, all_envs) for k, v in self.read(env.reset_state).items()}
        for key, value in entries.items():
            tensordict_reset.set(key, value)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, spec in self.specs(self.cleaning).items():
            observation_spec[key] = spec
        return observation_spec


def _spread(value: Tensor, rows: Tensor, num_envs: int) -> Tensor:
    """Put rows into a batch; TorchRL takes nothing but these rows from it."""
    return value.new_empty((num_envs, *value.shape[1:])).index_copy_(0, rows, value)


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
