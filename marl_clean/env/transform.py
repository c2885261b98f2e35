"""What transforms share: those that observe the worlds, and those that split the reward."""

from abc import abstractmethod
from typing import ClassVar

from jaxtyping import Bool, Float
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class WorldTransform(Transform):
    """Adds keys that `read` computes from the worlds of a `CleaningEnv`.

    The state is read by reference, from the env itself: a map published as a key would be copied
    at every partial reset and recorded at every step of a rollout. After a partial reset only
    the worlds that were reset are computed.

    Attributes:
        along: whether `read` is compiled into one call with the step, else in a call of its own
            after it. That call's loops are short, those over the robots of a world; a `read` with
            long ones, over a view, is several times faster alone.
    """

    along: ClassVar[bool] = False

    @abstractmethod
    def read(self, state: State, setup: Setup) -> Entries:
        """Return the entries for all worlds of `state`, a pure function of the two."""

    @abstractmethod
    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        """Return the spec of every entry that `read` gives."""

    @property
    def cleaning(self) -> CleaningEnv:
        """The env whose worlds are read."""
        return self.container.base_env

    def _read(self, state: State, setup: Setup) -> Entries:
        return self.cleaning.compiled(self.read, wide=not self.along)(state, setup)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        env = self.cleaning
        for key, value in self._read(env.state, env.setup).items():
            next_tensordict.set(key, value)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        env, rows = self.cleaning, self.cleaning.reset_rows
        if len(rows) == env.num_envs:
            entries = self._read(env.state, env.setup)
        else:
            fresh = self._read(env.reset_state, env.setup.of_rows(rows))
            entries = {key: _spread(value, rows, env.num_envs) for key, value in fresh.items()}
        for key, value in entries.items():
            tensordict_reset.set(key, value)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for key, spec in self.specs(self.cleaning).items():
            observation_spec[key] = spec
        return observation_spec


def _spread(value: Tensor, rows: Tensor, num_envs: int) -> Tensor:
    """Put rows into a batch; TorchRL uses only these rows of it."""
    return value.new_empty((num_envs, *value.shape[1:])).index_copy_(0, rows, value)


class RewardTransform(Transform):
    """Turns what each robot earned, `own_reward`, into what it is paid, by `pay`."""

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
