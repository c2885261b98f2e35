"""Independent deep Q-learning with shared weights: the paper's approach 2 (§3.4)."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.learning import acting
from marl_clean.learning.acting import Greedy
from marl_clean.learning.agent import Channels
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.networks import QNetwork
from marl_clean.settings import Precision

DONE, TERMINATED = (keys.AGENTS, keys.DONE), (keys.AGENTS, keys.TERMINATED)


class Iql(DeepQ):
    """Every robot learns the value of its own actions by deep Q-learning (arXiv 1312.5602).

        y_i = r_i + gamma^k (1 - terminated) Q'(o'_i, argmax_a Q(o'_i, a))
        loss = Huber(Q(o_i, a_i) - y_i), mean over frames and robots

    Messages are made anew from the replayed observations and adjacency, so the gradient of one
    robot's loss reaches the others along live edges; or, with `messages=replayed`, they are those
    that were heard, and who sent them learns nothing from it. All else as in `DeepQ`.
    """

    network: QNetwork
    loss_keys: ClassVar = {
        "action": keys.ACTION,
        "action_value": keys.ACTION_VALUE,
        "value": keys.CHOSEN_ACTION_VALUE,
        "reward": keys.REWARD,
        "done": DONE,
        "terminated": TERMINATED,
    }

    def make_network(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        channels: Channels,
    ) -> QNetwork:
        return QNetwork(encoder, comm, dueling, precision, self.num_actions, channels)

    @property
    def sees(self) -> Sequence[NestedKey]:
        return self.network.sees

    @property
    def history(self) -> int:
        return self.network.history

    def primer(self) -> TensorDictPrimer | None:
        network = self.network
        return acting.primer(network, self.n_agents) if network.carries else None

    def make_greedy(self, acting: bool, records_messages: bool) -> Greedy:
        replays = self.messages == "replayed" and not acting
        return Greedy(self.network, self.n_agents, acting, records_messages, replays)

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy; each robot draws for itself."""
        records = keys.MESSAGE in self.learns_from
        greedy = self.make_greedy(acting=True, records_messages=records).eval()
        return TensorDictSequential(greedy, self.coin(action_spec, keys.ACTION))

    def side_loss(self, frames: TensorDictBase) -> Tensor | float:
        """Return what the scheme's own loss comes to, such as the pull of dgn's attention."""
        if not self.network.comm.pull:
            return 0.0
        graph = {key: frames[key] for key in (keys.ADJACENCY, keys.DISTANCE_RANK)}
        now, then = frames, frames["next"].clone(recurse=False).update(graph)
        attention = self.network(acting.entries(self.network, now)).talk.attention
        with torch.no_grad():
            later = self.network(acting.entries(self.network, then)).talk.attention
        ratio = attention.clamp(min=1e-8).log() - later.clamp(min=1e-8).log()
        return self.network.comm.pull * (attention * ratio).sum(-1).mean()

    def for_loss(self, frames: TensorDictBase) -> None:
        """Give every robot its endings and its steps."""
        acting.give_robots_endings(frames)
        steps = frames[keys.STEPS_TO_NEXT_OBS]
        of_robots = frames["next", keys.REWARD].shape
        frames[keys.STEPS_TO_NEXT_OBS] = steps[..., None, None].expand(of_robots)
