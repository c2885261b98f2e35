"""Independent deep Q-learning with shared weights: the paper's approach 2 (§3.4)."""

from typing import ClassVar

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import Composite

from marl_clean import keys
from marl_clean.agent.base import DeepQ
from marl_clean.comm.base import Comm
from marl_clean.networks import QNetwork
from marl_clean.settings import Precision

SEEN = (keys.OBSERVATION, keys.ADJACENCY, keys.DISTANCE_RANK)
DONE, TERMINATED = (keys.AGENTS, keys.DONE), (keys.AGENTS, keys.TERMINATED)


class Greedy(TensorDictModuleBase):
    """Every robot's best action: the network, as what TorchRL calls a Q-value actor.

    One module in the place of three (network, choice, their sequence): a third of their time
    outside of the network, which counts where the network is small.
    """

    def __init__(self, network: QNetwork, tells: bool) -> None:
        super().__init__()
        self.network, self.tells = network, tells
        self.in_keys = list(SEEN)
        self.out_keys = [keys.ACTION, keys.ACTION_VALUE, keys.CHOSEN_ACTION_VALUE]
        if tells:
            self.out_keys += [keys.MESSAGE, keys.MESSAGE_BITS]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        value, message, bits = self.network(*(tensordict.get(key) for key in SEEN))
        chosen, action = value.max(-1, keepdim=True)
        tensordict.set(keys.ACTION_VALUE, value)
        tensordict.set(keys.CHOSEN_ACTION_VALUE, chosen)
        tensordict.set(keys.ACTION, action.squeeze(-1))
        if self.tells:
            tensordict.set(keys.MESSAGE, message)
            tensordict.set(keys.MESSAGE_BITS, bits)
        return tensordict


class Iql(DeepQ):
    """Every robot learns the value of its own actions by deep Q-learning (arXiv 1312.5602).

        y_i = r_i + gamma^k (1 - terminated) Q'(o'_i, argmax_a Q(o'_i, a))
        loss = Huber(Q(o_i, a_i) - y_i), mean over frames and robots

    Messages are made anew from the replayed observations and adjacency, so the gradient of one
    robot's loss reaches the others along live edges. All else as in `DeepQ`.
    """

    network: QNetwork
    sees = SEEN
    loss_keys: ClassVar = {
        "action": keys.ACTION,
        "action_value": keys.ACTION_VALUE,
        "value": keys.CHOSEN_ACTION_VALUE,
        "reward": keys.REWARD,
        "done": DONE,
        "terminated": TERMINATED,
    }

    def make_network(
        self, encoder: nn.Module, comm: Comm, dueling: bool, precision: Precision
    ) -> QNetwork:
        return QNetwork(encoder, comm, dueling, precision, self.num_actions)

    def make_greedy(self, tells: bool) -> Greedy:
        return Greedy(self.network, tells)

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy; each robot draws for itself."""
        return TensorDictSequential(self._greedy, self.coin(action_spec, keys.ACTION))

    def for_loss(self, frames: TensorDictBase) -> None:
        """Give every robot its endings and its steps."""
        reward = frames["next", keys.REWARD]
        for key in (keys.DONE, keys.TERMINATED):
            ending = frames["next", key].unsqueeze(-1).expand(reward.shape)
            frames["next", keys.AGENTS, key] = ending
        steps = frames[keys.STEPS_TO_NEXT_OBS]
        frames[keys.STEPS_TO_NEXT_OBS] = steps[:, None, None].expand(reward.shape)
