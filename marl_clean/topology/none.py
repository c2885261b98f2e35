"""`topology=none`."""

from typing import final

import torch
from jaxtyping import Bool
from torch import Tensor

from marl_clean.topology.base import Topology
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import everyone
from marl_clean.world.state import State


@final
class Nobody(Topology):
    """No robot ever talks to another."""

    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        return torch.zeros_like(everyone(state.position))

    def among(self, n_agents: int) -> Bool[Tensor, "agent agent"]:
        return torch.zeros(n_agents, n_agents, dtype=torch.bool)
