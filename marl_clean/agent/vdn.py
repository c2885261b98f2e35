"""Value decomposition: the robots' values add up to the team's, which is what is learnt."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs.utils import step_mdp
from torchrl.modules import VDNMixer
from torchrl.objectives import LossModule, QMixerLoss
from torchrl.objectives.utils import distance_loss

from marl_clean import keys
from marl_clean.agent.iql import Iql
from marl_clean.learning import acting


class DoubleQMixerLoss(QMixerLoss):
    """TorchRL's loss of mixed values, with double Q-learning (arXiv 1509.06461) if asked for.

    y = r + gamma^k (1 - terminated) mix'(Q'_1(o'_1, a'_1), ..., Q'_n(o'_n, a'_n)), where a'_i is
    the best action by Q_i, the online network's values, and mix' the target mixer.
    """

    def __init__(self, local: nn.Module, mixer: nn.Module, *, double: bool, function: str) -> None:
        super().__init__(local, mixer, loss_function=function, action_space="categorical")
        self.double = double

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.double:
            return super().forward(tensordict)
        now = self._chosen(
            tensordict.clone(recurse=False),
            self.local_value_network_params,
            self.mixer_network_params,
            tensordict.get(self.tensor_keys.action),
        )
        with torch.no_grad():
            then = step_mdp(tensordict, keep_other=False)
            best = then.clone(recurse=False)
            with self.local_value_network_params.data.to_module(self.local_value_network):
                action = self.local_value_network(best).get(self.tensor_keys.action)
            later = self._chosen(
                then,
                self.target_local_value_network_params,
                self.target_mixer_network_params,
                action,
            )
            target = self.value_estimator.value_estimate(
                tensordict, target_params=self._cached_target_params, next_value=later
            )
        loss = distance_loss(now, target, self.loss_function)
        return TensorDict(loss=loss.mean())

    def _chosen(
        self,
        frames: TensorDictBase,
        local: TensorDictBase,
        mixer: TensorDictBase,
        action: torch.Tensor,
    ) -> torch.Tensor:
        """Return the team's value `[*B, 1]` of what its robots do."""
        with local.to_module(self.local_value_network, preserve_module_state=False):
            value = self.local_value_network(frames).get(self.tensor_keys.action_value)
        frames.set(self.tensor_keys.local_value, value.gather(-1, action.unsqueeze(-1)))
        with mixer.to_module(self.mixer_network, preserve_module_state=False):
            return self.mixer_network(frames).get(self.tensor_keys.global_value)


class Vdn(Iql):
    """Each robot acts by its own value; their sum is held to the team's reward.

        Q(o, a) = Q_1(o_1, a_1) + ... + Q_n(o_n, a_n)
        y = (r_1 + ... + r_n) + gamma^k (1 - terminated) Q'(o', a'),    a'_i = argmax_a Q_i(o'_i, a)

    So the reward is the sum, never the mean, of the robots' own: `reward=team`. Robots share their
    weights and talk as under `iql`; nothing but the loss differs, and a trained policy acts alone.

    Source: arXiv 1706.05296; TorchRL's mixer.
    """

    fits = {"reward": ["team"], "trainer": ["off_policy"]}
    loss_keys: ClassVar = {
        "action": keys.ACTION,
        "action_value": keys.ACTION_VALUE,
        "local_value": keys.CHOSEN_ACTION_VALUE,
        "global_value": keys.TEAM_VALUE,
        "reward": "reward",
        "done": keys.DONE,
        "terminated": keys.TERMINATED,
    }
    network_of_loss = "local_value_network"
    only_in_loss: ClassVar = ("mixer_network",)
    mixed_by: ClassVar[Sequence[NestedKey]] = (keys.CHOSEN_ACTION_VALUE,)

    def make_mixer(self) -> nn.Module:
        """Return TorchRL's module from the robots' values to the team's."""
        return VDNMixer(n_agents=self.n_agents, device=self.device)

    def make_loss(self, function: str, double: bool) -> LossModule:
        self.mixer = TensorDictModule(
            self.make_mixer(), in_keys=list(self.mixed_by), out_keys=[keys.TEAM_VALUE]
        )
        return DoubleQMixerLoss(self._greedy, self.mixer, double=double, function=function)

    def only_in_learning(self) -> Sequence[nn.Module]:
        return (self.mixer,)

    def for_loss(self, frames: TensorDictBase) -> None:
        acting.take_team_reward(frames)
