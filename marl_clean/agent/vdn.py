"""Value decomposition: the robots' values add up to the team's, which is what is learnt."""

from typing import final

from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import VDNMixer

from marl_clean.learning.mixed_q import MixedQ


@final
class Vdn(MixedQ):
    """Each robot acts by its own value; their sum is held to the team's reward.

        Q(o, a) = Q_1(o_1, a_1) + ... + Q_n(o_n, a_n)
        y = (r_1 + ... + r_n) + gamma^k (1 - terminated) Q'(o', a'),    a'_i = argmax_a Q_i(o'_i, a)

    Robots share their weights and talk as under `iql`; nothing but the loss differs, which stands
    in `DeepQ.loss`. All else as in `MixedQ`.

    Source: arXiv 1706.05296; TorchRL's mixer.
    """

    fits = {"reward": ["team"], "trainer": ["off_policy"]}

    def make_mixer(self) -> nn.Module:
        return VDNMixer(n_agents=self.n_agents, device=self.device)

    def mix(
        self, mixer: nn.Module, value: Float[Tensor, "*batch agent 1"], frames: TensorDictBase
    ) -> Float[Tensor, "*batch 1"]:
        return mixer(value)
