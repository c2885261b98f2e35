"""QMIX: the team's value is any monotonous mixture of the robots', told by the true state."""

from collections.abc import Sequence
from typing import ClassVar

from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.modules import QMixer

from marl_clean import keys
from marl_clean.agent.vdn import Vdn

MIXING_DIM = 32  # width of the mixer's hidden layer, as in the source


class Qmix(Vdn):
    """Each robot acts by its own value; a network mixes them into the team's.

        Q(o, a) = mix(Q_1(o_1, a_1), ..., Q_n(o_n, a_n); s),    d mix / d Q_i >= 0

    The weights of the mixture are made of the true state s, which no robot sees; they are needed
    in learning alone, and they are for one number of robots and one size of house. All else as in
    `Vdn`.

    Source: arXiv 1803.11485; TorchRL's mixer.
    """

    fits = {"reward": ["team"], "trainer": ["off_policy"], "env": ["cleaning"]}
    needs_state = True
    mixed_by: ClassVar[Sequence[NestedKey]] = (keys.CHOSEN_ACTION_VALUE, keys.STATE)

    def make_mixer(self) -> nn.Module:
        return QMixer(
            state_shape=self.state_shape,
            mixing_embed_dim=MIXING_DIM,
            n_agents=self.n_agents,
            device=self.device,
        )

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        return (*super().learns_from, keys.STATE, ("next", keys.STATE))

    def for_loss(self, frames: TensorDictBase) -> None:
        super().for_loss(frames)
        for part in (frames, frames["next"]):
            part[keys.STATE] = part[keys.STATE].float()
