"""QMIX: the team's value is any monotonic mixture of the robots', given the true state."""

from collections.abc import Sequence
from typing import final

from jaxtyping import Float
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import QMixer

from marl_clean import keys
from marl_clean.learning.mixed_q import MixedQ

MIXING_DIM = 32  # width of the mixer's hidden layer, as in the source


@final
class Qmix(MixedQ):
    """Each robot acts by its own value; a network mixes them into the team's.

        Q(o, a) = mix(Q_1(o_1, a_1), ..., Q_n(o_n, a_n); s),    d mix / d Q_i >= 0
        y = (r_1 + ... + r_n) + gamma^k (1 - terminated) Q'(o', a'),    a'_i = argmax_a Q_i(o'_i, a)

    The weights of the mixture are made of the true state s, which no robot sees; they are needed
    in learning alone, and they are for one number of robots and one size of house. The loss stands
    in `DeepQ.loss`. All else as in `MixedQ`.

    Source: arXiv 1803.11485; TorchRL's mixer.
    """

    fits = {"reward": ["team"], "trainer": ["off_policy"], "env": ["cleaning"]}
    needs_state = True

    def make_mixer(self) -> nn.Module:
        return QMixer(
            state_shape=self.state_shape,
            mixing_embed_dim=MIXING_DIM,
            n_agents=self.n_agents,
            device=self.device,
        )

    def mix(
        self, mixer: nn.Module, value: Float[Tensor, "*batch agent 1"], frames: TensorDictBase
    ) -> Float[Tensor, "*batch 1"]:
        return mixer(value, frames[keys.STATE].float())

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        return (*super().learns_from, keys.STATE, ("next", keys.STATE))
