"""What every learner offers, and the network from what robots see to action values."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Composite

from marl_clean.comm.base import Comm
from marl_clean.settings import Precision

NUM_ACTIONS = 4
"""Up, right, down, left (paper §3.2); there is no way to stay."""


class QNetwork(nn.Module):
    """Values of the four actions of every robot: encoder, communication, head (paper figure 4).

        plain:   Q(o, a) = head(h')_a
        dueling: Q(o, a) = V(h') + A(h')_a - mean over a' of A(h')_a'      (arXiv 1511.06581)

    All robots share the weights, so any number of robots fits. `precision` is that of the
    encoder's arithmetic, where the time goes; messages and values stay float32.
    """

    def __init__(self, encoder: nn.Module, comm: Comm, dueling: bool, precision: Precision) -> None:
        super().__init__()
        self.encoder = encoder
        self.comm = comm
        self.dueling = dueling
        self.reduced = precision == "bfloat16"
        self.head = nn.Linear(comm.out_features, NUM_ACTIONS + dueling)

    def forward(
        self,
        observation: Float[Tensor, "*batch agent channel row col"],
        adjacency: Bool[Tensor, "*batch agent agent"],
        distance_rank: Int[Tensor, "*batch agent agent"],
    ) -> tuple[
        Float[Tensor, "*batch agent action"],
        Float[Tensor, "*batch agent message"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return action values, the messages sent, and what sending them cost in bits."""
        with torch.autocast(observation.device.type, torch.bfloat16, enabled=self.reduced):
            feature = self.encoder(observation)
        feature, message, bits = self.comm(feature.float(), adjacency, distance_rank)
        value = self.head(feature)
        if self.dueling:
            advantage = value[..., 1:]
            value = value[..., :1] + advantage - advantage.mean(-1, keepdim=True)
        return value, message, bits


class Agent(ABC):
    """A learner that acts: a greedy policy, an exploring one, and one step of learning.

    Attributes:
        network: the module whose weights are kept, shared by both policies.
        learns_from: keys of a frame that learning needs; under "next", of the frame after.
        gamma: discount of a step.
        n_steps: rewards summed before bootstrapping.
        epsilon: share of random actions now.
    """

    network: nn.Module
    learns_from: Sequence[NestedKey]
    gamma: float
    n_steps: int
    epsilon: float

    @abstractmethod
    def policy(self) -> TensorDictModuleBase:
        """Return the greedy policy; it follows the weights as they are learnt."""

    @abstractmethod
    def exploration(self, action_spec: Composite) -> TensorDictModuleBase:
        """Return the policy that collects experience; `action_spec` is the env's, all keys."""

    @abstractmethod
    def anneal(self, progress: float) -> None:
        """Set exploration for a run of which `progress`, from 0 to 1, is done."""

    def start_from(self, weights: dict[str, Tensor]) -> None:
        """Begin to learn with a network's weights, those of a target network too."""
        state = self.state_dict()
        for name in ("network", "target"):
            if name in state:
                state[name] = weights
        self.load_state_dict(state)

    @abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Learn from a batch of frames; return measures of it as tensors without a graph."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return all that learning goes on from, as dicts and lists of tensors and numbers."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state of `state_dict`, exactly."""
