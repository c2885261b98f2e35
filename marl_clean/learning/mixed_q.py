"""Value decomposition, as several learners share it: the robots' values make the team's."""

from abc import abstractmethod

from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor, nn

from marl_clean.learning import acting
from marl_clean.learning.robots_q import RobotsQ

MIXER = "mixer_network"  # as states of runs in progress name it


class MixedQ(RobotsQ):
    """Robots act by their own values; what is learnt is the team's, which a mixer makes of them.

        Q(o, a) = mix(Q_1(o_1, a_1), ..., Q_n(o_n, a_n); s)
        y = (r_1 + ... + r_n) + gamma^k (1 - terminated) Q'(o', a'),    a'_i = argmax_a Q_i(o'_i, a)

    The target's Q' has a target mixer. The reward is the sum, never the mean, of the robots' own:
    `reward=team`. A trained policy acts without the mixer. All else as in `RobotsQ`.
    """

    @abstractmethod
    def make_mixer(self) -> nn.Module:
        """Return TorchRL's module from the robots' values, `[*B, n, 1]`, to the team's."""

    @abstractmethod
    def mix(
        self, mixer: nn.Module, value: Float[Tensor, "*batch agent 1"], frames: TensorDictBase
    ) -> Float[Tensor, "*batch 1"]:
        """Return the team's value."""

    def only_in_learning(self) -> dict[str, nn.Module]:
        return super().only_in_learning() | {MIXER: nn.ModuleDict({"module": self.make_mixer()})}

    def value_of(
        self,
        modules: nn.ModuleDict,
        value: Float[Tensor, "*batch agent action"],
        action: Tensor,
        frames: TensorDictBase,
    ) -> Float[Tensor, "*batch 1"]:
        of_robots = super().value_of(modules, value, action, frames)
        return self.mix(modules[MIXER].get_submodule("module"), of_robots, frames)

    def reward(self, frames: TensorDictBase) -> Float[Tensor, "*batch 1"]:
        return acting.team_reward(frames)
