"""Robots in contact hear what lies around each other, and see by it where their own map is blank.

A patch is what the sender's own map holds of the 7 x 7 cells around it when the step begins, as one
of four classes a cell. Hearers keep it apart from their own map: `heard_record` has the last that
was heard of each cell, and is seen where a robot's own map does not know the cell, or knows it not
to be cleaned and hears that it has been. What a robot is paid and what it tells others are by its
own map alone, so that an error is neither paid for nor passed on.

Patches are the world's own, whole, or a policy's, which sends them through a code: `coded`.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int8
from torch import Tensor

from marl_clean.settings import Tells
from marl_clean.world.sensing import windows_around
from marl_clean.world.shared_map import (
    UNKNOWN_RECORD,
    is_known_blocked,
    is_known_free,
    is_known_uncleaned,
    is_unknown,
)
from marl_clean.world.state import State

SIDE = 7  # cells, the robot in the middle
REACH_CELLS = SIDE // 2
UNKNOWN, BLOCKED, NEVER_CLEANED, CLEANED = range(4)
NUM_CLASSES = 4


class Patches(NamedTuple):
    """Robots in contact hear each other's patches.

    Attributes:
        coded: they are what a policy makes of messages, and the env is given them with each step;
            else they are the senders' own.
        tells: of which cells, where they are the senders' own.
    """

    coded: bool
    tells: Tells = "all"


class Heard(NamedTuple):
    """Patches that are heard in a step.

    Attributes:
        patch: `[env, agent, 49]` int8, of each sender: a class a cell, row by row; `UNKNOWN` tells
            nothing.
        edges: `[env, agent, agent]` bool, [i, j]: i hears the patch of j.
        place: `[env, agent, 2]` int64, (row, col) in the house: where each sender spoke. So a patch
            that is handed over twice says nothing new, and nothing wrong.
    """

    patch: Tensor
    edges: Tensor
    place: Tensor


def begin_patches_(state: State, patches: Patches) -> None:
    """Add what hearing of patches keeps to worlds at the start of their episodes."""
    state.own_record = state.record.clone()
    state.heard_record = torch.full_like(state.record, UNKNOWN_RECORD)
    if not patches.coded:
        state.exchanged_bits = torch.zeros_like(state.position[..., 0])


def classes(record: Float[Tensor, "..."]) -> Int8[Tensor, "..."]:
    """Return which of the four classes a map's records are of."""
    free = torch.where(is_known_uncleaned(record), NEVER_CLEANED, CLEANED)
    known = torch.where(is_known_free(record), free, UNKNOWN)
    return torch.where(is_known_blocked(record), BLOCKED, known).to(torch.int8)


def own_patches(state: State, margin: int) -> Int8[Tensor, "env agent cell"]:
    """Return what each robot knows by itself of the cells around it."""
    own = state.record if state.own_record is None else state.own_record
    return classes(windows_around(own, state.position, SIDE, margin)).flatten(2)


def tell_own_(
    state: State, contact: Bool[Tensor, "env agent agent"], tells: Tells, margin: int
) -> None:
    """Let robots in contact hear each other's patches as they are, before they move.

    A patch of all classes has two bits a cell, that of the cells of one class a bit.
    """
    patch, bits = own_patches(state, margin), 2
    if tells != "all":
        told = CLEANED if tells == "cleaned" else BLOCKED
        patch, bits = torch.where(patch == told, patch, UNKNOWN).to(torch.int8), 1
    hear_(state, Heard(patch, contact, state.position), margin)
    state.exchanged_bits = SIDE**2 * bits * contact.sum(1)  # over those who hear


def hear_(state: State, heard: Heard, margin: int) -> None:
    """Keep what is heard, in place, before robots move.

    Of several patches that tell of one cell, cleaned counts before never cleaned, and that before
    blocked. What was heard of a cell before is replaced. What is said of cells outside the house
    and the ring around it is not kept: there is nothing to see.
    """
    assert state.heard_record is not None
    width = state.blocked.shape[2]
    steps = torch.arange(SIDE, device=heard.place.device) - REACH_CELLS
    row = (heard.place[..., 0, None] + steps)[..., None]  # of each cell of a sender's patch
    col = (heard.place[..., 1, None] + steps)[..., None, :]
    is_row = (row >= -1) & (row <= state.rows[:, None, None, None])
    is_col = (col >= -1) & (col <= state.cols[:, None, None, None])
    cell = ((row + margin) * width + col + margin).flatten(2)
    patch = torch.where((is_row & is_col).flatten(2), heard.patch, UNKNOWN)
    told = torch.where(heard.edges[..., None], patch[:, None], UNKNOWN)
    best = torch.zeros_like(state.heard_record, dtype=torch.int8).flatten(2)
    index = cell[:, None].expand_as(told).flatten(2)
    best = best.scatter_reduce(2, index, told.flatten(2), "amax").view_as(state.heard_record)
    now = (state.step + 1).to(state.record.dtype)[:, None, None, None]
    # As if it had just been cleaned, or seen: what is known of its time is that it is no later.
    value = torch.where(best == BLOCKED, -now, torch.where(best == CLEANED, now, now - 0.5))
    state.heard_record = torch.where(best == UNKNOWN, state.heard_record, value)


def see_by_heard_(state: State) -> None:
    """Let `record` show what was heard where the robot's own map lacks it, in this step."""
    assert state.heard_record is not None
    own, heard = state.record, state.heard_record
    cleaned = is_known_free(heard) & ~is_known_uncleaned(heard)
    lacks = is_unknown(own) | (is_known_uncleaned(own) & cleaned & (heard > own))
    state.own_record = own
    state.record = torch.where(lacks & ~is_unknown(heard), heard, own)
