"""`topology=full`."""

from typing import final

import torch
from jaxtyping import Bool
from torch import Tensor

from marl_clean.topology.base import Topology
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import everyone
from marl_clean.world.state import State


@final
class Full(Topology):
    """Every robot talks to every other, always."""

    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        return everyone(state.position)

    def among(self, n_agents: int) -> Bool[Tensor, "agent agent"]:
        return ~torch.eye(n_agents, dtype=torch.bool)
