"""The robots' memory: one number a cell, turned into the paper's value only where looked at.

A record holds everything that is known of a cell and the step it was learnt, so that ageing
costs nothing and two maps can be united (paper §3.2):

    record  0         unknown
    record -(t + 1)   blocked, learnt at step t
    record +(t + 1)   available, last cleaned at step t
    record +(t + 1/2) available and dirty, learnt at step t but not cleaned since
    record +(t + 3/4) available and dirty by a spill, noticed at step t and not cleaned since

Knowledge from before the episode is older than all of these, blocked or not: -1/8 and +1/8.
With now = t + 1, the age of a record is now - record. float32 holds them up to 2^22 steps.
A robot cleans the cell it stands on at every step, so in its own map the cells of age 0 are
exactly those with a robot on them.
"""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.world.rules import (
    BLOCKED_VALUE,
    CLEANED_VALUE,
    DIRTY_VALUE,
    ROBOT_VALUE,
    UNKNOWN_VALUE,
    Rules,
)

UNKNOWN_RECORD = 0.0
MEMORISED_FREE = 0.125
MEMORISED_BLOCKED = -0.125
SPILT_FRACTION = 0.75


def is_unknown(record: Tensor) -> Tensor:
    return record == UNKNOWN_RECORD


def is_known_blocked(record: Tensor) -> Tensor:
    return record < 0


def is_known_free(record: Tensor) -> Tensor:
    return record > 0


def is_known_dirty(record: Tensor, now: Tensor, rules: Rules) -> Tensor:
    """Tell where the map says: available, and the value has fallen to exactly 0."""
    return (record > 0) & (_is_touched(record) | (now - record >= rules.dirty_after))


def is_known_uncleaned(record: Tensor) -> Tensor:
    """Tell where the map says: available, and not cleaned since the episode or a spill there."""
    return (record > 0) & _is_touched(record)


def is_known_spilt(record: Tensor) -> Tensor:
    """Tell where the map says: available, and dirty because of a spill."""
    return (record > 0) & (record - record.floor() == SPILT_FRACTION)


def spilt_record(now: Tensor) -> Tensor:
    """Return the record of a cell whose spill is noticed at step `now` - 1."""
    return now - 1 + SPILT_FRACTION


def map_value(record: Tensor, now: Tensor, rules: Rules) -> Tensor:
    """Return the paper's value of cells: -1, -0.2, 0 to 0.5, or 1 for a robot's (§3.2).

    `now` is the step + 1, as float32, broadcast against `record`. The result has the shape of
    both and is float32; ageing is decided on whole steps, only the shown value is rounded.
    """
    age = now - record
    faded = CLEANED_VALUE - rules.decay_a_step * age
    dirty = (age >= rules.dirty_after) | _is_touched(record)
    value = torch.where(dirty, DIRTY_VALUE, faded)
    value = torch.where(age == 0, ROBOT_VALUE, value)
    value = torch.where(record < 0, BLOCKED_VALUE, value)
    return torch.where(record == UNKNOWN_RECORD, UNKNOWN_VALUE, value)


def shown_value(record: Tensor, now: Tensor, rules: Rules) -> Tensor:
    """Return `map_value` as robots see it: without `robots_shown` no cell shows a robot.

    The map then shows what it holds of such a cell: that it has just been cleaned.
    """
    value = map_value(record, now, rules)
    if rules.robots_shown:
        return value
    return torch.where(value == ROBOT_VALUE, CLEANED_VALUE, value)


def _is_touched(record: Tensor) -> Tensor:
    return record != record.floor()


def write_records_(
    record: Float[Tensor, "env map height width"],
    index: Int[Tensor, "*entry"],
    value: Float[Tensor, "*entry"],
) -> None:
    """Write records in place; the one place where a map changes during an episode.

    `index` is flat over the whole tensor. Entries that meet in one cell carry one value.
    """
    record.view(-1).index_put_((index.reshape(-1),), value.reshape(-1))


def merge_maps(
    record: Float[Tensor, "env agent height width"], contact: Bool[Tensor, "env agent agent"]
) -> Float[Tensor, "env agent height width"]:
    """Unite each robot's map with those of the robots it is in contact with.

    Pairwise, from the maps as they were before; the record of the later step wins, of equals
    blocked wins. Costs n^2 times the house, as `memory=merged` may.
    """
    merged, merged_rank = record, recency(record)
    for other in range(record.shape[1]):
        offered = record[:, other, None]
        rank = torch.where(contact[:, :, other, None, None], recency(offered), 0.0)
        merged = torch.where(rank > merged_rank, offered, merged)
        merged_rank = torch.maximum(merged_rank, rank)
    return merged


def recency(record: Tensor) -> Tensor:
    """Order records: the later step first, and at the same step blocked before available."""
    return record.abs() * 4 + (record < 0)


def union_of_maps(record: Float[Tensor, "env map ..."]) -> Float[Tensor, "env ..."]:
    """Return what the robots know between them of cells; the measures are of this map."""
    return record.gather(1, recency(record).argmax(1, keepdim=True))[:, 0]
