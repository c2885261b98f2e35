"""Robots in contact lend each other their private maps for as long as the contact lasts.

In each step a robot sees by the union of its own map and those of the robots in contact, and keeps
nothing of it: with the next step its own map is back before it moves, see `dynamics.advance_`.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool
from torch import Tensor

from marl_clean.world.shared_map import merge_maps
from marl_clean.world.state import State


class Lending(NamedTuple):
    """Robots in contact lend each other their maps; there is nothing to set."""


def begin_lending_(state: State) -> None:
    """Add what lending keeps to worlds at the start of their episodes."""
    state.own_record = state.record.clone()
    state.exchanged_bits = torch.zeros_like(state.position[..., 0])


def lend_(state: State, contact: Bool[Tensor, "env agent agent"]) -> None:
    """Let `record` be the union of a robot's own map and those lent to it, in this step.

    For each cell of the house and the ring around it a message has two bits for what it is
    (unknown, blocked, dirty or cleaned), and the step at which that was learnt.
    """
    state.own_record = state.record
    state.record = merge_maps(state.record, contact)
    steps = state.max_steps.to(torch.float64).log2().floor().long() + 1
    bits = (state.rows + 2) * (state.cols + 2) * (2 + steps)
    state.exchanged_bits = bits[:, None] * contact.sum(1)  # over those who hear
