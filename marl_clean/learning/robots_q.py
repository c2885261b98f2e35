"""Deep Q-learning in which every robot has action values of its own."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.learning import acting
from marl_clean.learning.acting import Greedy, entries
from marl_clean.learning.agent import Channels
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.grounding import GROUNDING, Grounding, ground_loss, grounding_of
from marl_clean.learning.networks import QNetwork, RobotsNetwork
from marl_clean.learning.representing import PREDICTION, Prediction, predict_loss, prediction_of
from marl_clean.settings import Precision


class RobotsQ(DeepQ):
    """Every robot acts by its own values Q_i(o_i, .), of one network that all share.

    Messages are made anew from the replayed observations and adjacency, so the gradient of one
    robot's loss reaches the others along live edges; or, with `messages=replayed`, they are those
    that were heard, and their senders learn nothing from it. All else as in `DeepQ`.
    """

    network: QNetwork

    def make_network(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        channels: Channels,
    ) -> QNetwork:
        size = self.num_actions
        return QNetwork(encoder, comm, dueling, precision, size, channels, self.mask_walls)

    @property
    def sees(self) -> Sequence[NestedKey]:
        return self.network.sees

    @property
    def history(self) -> int:
        return self.network.history

    def primer(self) -> TensorDictPrimer | None:
        network = self.network
        return acting.primer(network, self.n_agents) if network.carries else None

    def make_greedy(self, records_messages: bool) -> Greedy:
        return Greedy(self.network, self.n_agents, records_messages)

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy; each robot draws for itself."""
        return self._acting(action_spec)

    def demonstrated_by(
        self, planner: TensorDictModuleBase, action_spec: Composite
    ) -> TensorDictSequential:
        return self._acting(action_spec, planner)

    def _acting(
        self, action_spec: Composite, *instead: TensorDictModuleBase
    ) -> TensorDictSequential:
        greedy = self.make_greedy(records_messages=self.messages == "replayed")
        return acting.epsilon_greedy(greedy, self.exploring, action_spec, *instead)

    def values(
        self, network: RobotsNetwork, frames: TensorDictBase
    ) -> Float[Tensor, "*batch agent action"]:
        seen = entries(network, frames)
        sent = frames.get(keys.MESSAGE) if self.messages == "replayed" else None
        if keys.IS_INIT in frames.keys():  # frames in a row; what follows them is one by one
            return network.unroll(frames[keys.IS_INIT], seen, sent)
        return network(seen, sent).out

    def only_in_learning(self) -> dict[str, nn.Module]:
        grounding = grounding_of(self.network.comm, self.device)
        prediction = prediction_of(self.network.comm, self.num_actions)
        parts = {GROUNDING: grounding, PREDICTION: prediction}
        return {name: part for name, part in parts.items() if part is not None}

    @property
    def grounding(self) -> Grounding | None:
        """The losses that ground messages, if they are."""
        part = self.learnt[GROUNDING] if GROUNDING in self.learnt else None
        assert part is None or isinstance(part, Grounding)
        return part

    @property
    def grounded_in(self) -> Sequence[NestedKey]:
        return () if self.grounding is None else self.grounding.sees

    def side_loss(self, frames: TensorDictBase) -> tuple[Tensor | float, dict[str, Tensor]]:
        """Return what the scheme's own losses come to: pull, prediction and grounding."""
        total, measures = ground_loss(self.grounding, self.network, frames)
        if PREDICTION in self.learnt:
            part, target = self.learnt[PREDICTION], self.target["network"]
            assert isinstance(part, Prediction) and isinstance(target, RobotsNetwork)
            loss = predict_loss(part, self.network, target, frames)
            total, measures = total + part.weight * loss, {**measures, "predict": loss.detach()}
        return self.pull_loss(frames) + total, measures

    def pull_loss(self, frames: TensorDictBase) -> Tensor | float:
        """Return pull x KL(a || a') of dgn's attention a and the next frame's a'."""
        if not self.network.comm.pull:
            return 0.0
        graph = {key: frames[key] for key in keys.GRAPH if key in self.sees}
        now, then = frames, frames["next"].clone(recurse=False).update(graph)
        attention = self.network(entries(self.network, now)).talk.attention
        with torch.no_grad():
            later = self.network(entries(self.network, then)).talk.attention
        ratio = attention.clamp(min=1e-8).log() - later.clamp(min=1e-8).log()
        return self.network.comm.pull * (attention * ratio).sum(-1).mean()
