"""QMIX: the team's value is any monotonous mixture of the robots', told by the true state."""

from collections.abc import Sequence
from typing import ClassVar, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torch import nn
from torchrl.modules import QMixer

from marl_clean import keys
from marl_clean.agent.base import Channels, Count
from marl_clean.agent.vdn import Vdn
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.settings import PositiveFloat, PositiveInt, PositiveShare, Precision, Probability


class Qmix(Vdn):
    """Each robot acts by its own value; a network mixes them into the team's.

        Q(o, a) = mix(Q_1(o_1, a_1), ..., Q_n(o_n, a_n); s),    d mix / d Q_i >= 0

    The weights of the mixture are made of the true state s, which no robot sees; they are needed
    in learning alone, and they are for one number of robots and one size of house. All else as in
    `Vdn`.

    Source: arXiv 1803.11485; TorchRL's mixer.

    Args:
        mixing_dim: width of the mixer's hidden layer.
        state_shape: of the state that learning is told.

    Others are those of `DeepQ`.
    """

    fits = {"reward": ["team"], "trainer": ["off_policy"], "env": ["cleaning"]}
    needs_state = True
    mixed_by: ClassVar[Sequence[NestedKey]] = (keys.CHOSEN_ACTION_VALUE, keys.STATE)

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        mixing_dim: PositiveInt,
        state_shape: torch.Size,
        double: bool,
        dueling: bool,
        n_steps: PositiveInt,
        gamma: Probability,
        lr: PositiveFloat,
        lr_end: PositiveFloat,
        loss: Literal["smooth_l1", "l2", "l1"],
        max_grad_norm: PositiveFloat,
        target_update: Literal["soft", "hard"],
        tau: PositiveShare,
        target_period: PositiveInt,
        eps_init: Probability,
        eps_end: Probability,
        annealing_fraction: Probability,
        precision: Precision,
        augment: bool,
        messages: Literal["recomputed", "replayed"],
        next_graph: Literal["own", "reused"],
        channels: Channels,
        n_agents: Count,
        num_actions: Count,
        device: torch.device | str = "cpu",
    ) -> None:
        self.mixing_dim, self.state_shape = mixing_dim, state_shape
        super().__init__(
            encoder,
            comm,
            double,
            dueling,
            n_steps,
            gamma,
            lr,
            lr_end,
            loss,
            max_grad_norm,
            target_update,
            tau,
            target_period,
            eps_init,
            eps_end,
            annealing_fraction,
            precision,
            augment,
            messages,
            next_graph,
            channels,
            n_agents,
            num_actions,
            device,
        )

    def make_mixer(self) -> nn.Module:
        return QMixer(
            state_shape=self.state_shape,
            mixing_embed_dim=self.mixing_dim,
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
