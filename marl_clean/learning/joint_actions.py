"""Joint actions: their numbers, their masks, and the network that values them."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.encoder.base import Encoder
from marl_clean.learning.arithmetic import reduced_for
from marl_clean.learning.networks import NUM_ACTIONS, duel, masked
from marl_clean.settings import Precision


class JointQNetwork(nn.Module):
    """Values of the 4^n joint actions of n robots, from all that they see (paper §3.4, approach 1).

        h = [encoder(o_1), ..., encoder(o_n)],    Q(o, a_1 ... a_n) = head(relu(W h))

    One encoder encodes every robot's square; the features are concatenated in the robots' order,
    so the network is for this number of robots. `dueling` and `precision` as in `QNetwork`. A joint
    action is masked if any robot's action in it is.
    """

    def __init__(
        self,
        encoder: Encoder,
        width: int,
        n_agents: int,
        num_actions: int,
        dueling: bool,
        precision: Precision,
    ) -> None:
        super().__init__()
        outputs = num_actions**n_agents
        self.encoder = encoder
        self.dueling = dueling
        self.precision: Precision = precision
        hidden = 2 * width  # as much as two robots' features, whatever their number
        self.join = nn.Sequential(nn.Linear(n_agents * width, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, outputs + dueling)

    def forward(
        self,
        observation: Float[Tensor, "..."],
        allowed: Bool[Tensor, "*batch joint_action"] | None = None,
    ) -> Float[Tensor, "*batch joint_action"]:
        with reduced_for(observation, self.precision):
            feature = self.encoder(observation)
        value = self.head(self.join(feature.float().flatten(-2)))
        value = duel(value) if self.dueling else value
        return value if allowed is None else masked(value, allowed)


def joint_mask(
    allowed: Bool[Tensor, "*batch agent action"],
) -> Bool[Tensor, "*batch joint_action"]:
    """Return which joint actions contain no masked action."""
    n_agents, num_actions = allowed.shape[-2:]
    joint = torch.arange(num_actions**n_agents, device=allowed.device)
    robot = torch.arange(n_agents, device=allowed.device)
    return allowed[..., robot, decode_joint(joint, n_agents, num_actions)].all(-1)


def encode_joint(
    action: Int[Tensor, "*batch agent"], num_actions: int = NUM_ACTIONS
) -> Int[Tensor, "*batch"]:
    """Return a joint action's number in base `num_actions`, robot 0 the lowest digit."""
    return (action * _digits(action.shape[-1], num_actions, action.device)).sum(-1)


def decode_joint(
    joint: Int[Tensor, "*batch"], n_agents: int, num_actions: int = NUM_ACTIONS
) -> Int[Tensor, "*batch agent"]:
    """Return every robot's action of a numbered joint action; the inverse of `encode_joint`."""
    return joint.unsqueeze(-1) // _digits(n_agents, num_actions, joint.device) % num_actions


def _digits(n_agents: int, num_actions: int, device: torch.device) -> Int[Tensor, " agent"]:
    return num_actions ** torch.arange(n_agents, device=device)
