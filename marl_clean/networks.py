"""The networks from what robots see to action values, that several learners share."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.comm.base import Comm
from marl_clean.settings import Precision

NUM_ACTIONS = 4
"""Up, right, down, left (paper §3.2); there is no way to stay."""


def duel(value: Float[Tensor, "*batch one_and_actions"]) -> Float[Tensor, "*batch action"]:
    """Join a state's value and its actions' advantages: V + A_a - mean over a' of A_a'.

    Source: dueling networks, arXiv 1511.06581.
    """
    advantage = value[..., 1:]
    return value[..., :1] + advantage - advantage.mean(-1, keepdim=True)


class QNetwork(nn.Module):
    """Values of every robot's actions: encoder, communication, head (paper figure 4).

        plain:   Q(o, a) = head(h')_a
        dueling: Q(o, a) = V(h') + A(h')_a - mean over a' of A(h')_a'      (arXiv 1511.06581)

    All robots share the weights, so any number of robots fits. `precision` is that of the
    encoder's arithmetic, where the time goes; messages and values stay float32.
    """

    def __init__(
        self,
        encoder: nn.Module,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        num_actions: int = NUM_ACTIONS,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.comm = comm
        self.dueling = dueling
        self.reduced = precision == "bfloat16"
        self.head = nn.Linear(comm.out_features, num_actions + dueling)

    def forward(
        self,
        observation: Float[Tensor, "..."],
        adjacency: Bool[Tensor, "*batch agent agent"],
        distance_rank: Int[Tensor, "*batch agent agent"],
    ) -> tuple[
        Float[Tensor, "*batch agent action"],
        Float[Tensor, "*batch agent message"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return action values, the messages sent, and what sending them cost in bits.

        `observation` is [*batch, agent, ...], as the encoder takes it.
        """
        with torch.autocast(observation.device.type, torch.bfloat16, enabled=self.reduced):
            feature = self.encoder(observation)
        feature, message, bits = self.comm(feature.float(), adjacency, distance_rank)
        value = self.head(feature)
        return (duel(value) if self.dueling else value), message, bits


class JointQNetwork(nn.Module):
    """Values of the 4^n joint actions of n robots, from all that they see (paper §3.4, approach 1).

        h = [encoder(o_1), ..., encoder(o_n)],    Q(o, a_1 ... a_n) = head(relu(W h))

    One encoder looks at every robot's square; what it makes of them is joined in the robots'
    order, so the network is for this number of robots. `dueling` and `precision` as in `QNetwork`.
    """

    def __init__(
        self,
        encoder: nn.Module,
        width: int,
        n_agents: int,
        outputs: int,
        dueling: bool,
        precision: Precision,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.dueling = dueling
        self.reduced = precision == "bfloat16"
        hidden = 2 * width  # as much as two robots' features, whatever their number
        self.join = nn.Sequential(nn.Linear(n_agents * width, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, outputs + dueling)

    def forward(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch joint_action"]:
        with torch.autocast(observation.device.type, torch.bfloat16, enabled=self.reduced):
            feature = self.encoder(observation)
        value = self.head(self.join(feature.float().flatten(-2)))
        return duel(value) if self.dueling else value


def encode_joint(
    action: Int[Tensor, "*batch agent"], num_actions: int = NUM_ACTIONS
) -> Int[Tensor, "*batch"]:
    """Number a joint action in base `num_actions`, robot 0 the lowest digit."""
    return (action * _digits(action.shape[-1], num_actions, action.device)).sum(-1)


def decode_joint(
    joint: Int[Tensor, "*batch"], n_agents: int, num_actions: int = NUM_ACTIONS
) -> Int[Tensor, "*batch agent"]:
    """Return every robot's action of a numbered joint action; undoes `encode_joint`."""
    return joint.unsqueeze(-1) // _digits(n_agents, num_actions, joint.device) % num_actions


def _digits(n_agents: int, num_actions: int, device: torch.device) -> Int[Tensor, " agent"]:
    return num_actions ** torch.arange(n_agents, device=device)
