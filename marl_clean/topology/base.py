"""Who may talk to whom, as a transform (paper §3.4)."""

from abc import abstractmethod

import torch
from jaxtyping import Bool
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.errors import BadInput
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import distance_rank
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class Topology(WorldTransform):
    """Adds which robots are in contact, and their ranks by distance.

    `("agents", "adjacency")`, bool `[*B, n, n]`: symmetric with a false diagonal.
    `("agents", "distance_rank")`, int64 `[*B, n, n]`: 0 the robot itself, 1 the nearest, ...
    """

    along = True

    @abstractmethod
    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        """Return which robots are in contact, a pure function of the two."""

    def among(self, n_agents: int) -> Bool[Tensor, "agent agent"]:
        """Return which agents are in contact in an env without positions.

        Raises:
            BadInput: contact depends on positions.
        """
        level = type(self).__module__.rpartition(".")[2]
        raise BadInput(
            f"topology={level}: needs positions, which env does not have; valid: full, none"
        )

    def read(self, state: State, setup: Setup) -> Entries:
        return {
            keys.ADJACENCY: self.contact(state, setup.rules),
            keys.DISTANCE_RANK: distance_rank(state.position),
        }

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, env.n_agents])
        return {
            keys.ADJACENCY: Binary(env.n_agents, shape, device=env.device, dtype=torch.bool),
            keys.DISTANCE_RANK: Bounded(
                0, max(env.n_agents - 1, 1), shape, device=env.device, dtype=torch.int64
            ),
        }
