"""Robots in contact tell each other what changed in their private maps, a few cells a step.

Every cell of a map has the step at which what the map says of it last changed, and the robot that
it was heard from. A robot tells each robot in contact the cells that changed since it last told
that robot, the oldest first, at most `cells` of them a step, and never a cell that it heard from
that very robot. Without decay it is no change when a cleaned cell is cleaned again.

As `memory=merged` it may cost as much as the house has cells.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import UNKNOWN_RECORD, is_known_uncleaned, recency, write_records_
from marl_clean.world.state import State

NOBODY = -1


class Exchange(NamedTuple):
    """How robots in contact exchange parts of their maps.

    Attributes:
        cells: how many a robot tells another in a step at most.
    """

    cells: int


class Told(NamedTuple):
    """What robots in contact tell each other in a step: one row an edge.

    Attributes:
        env, hearer, sender: `[edge]` int64, the ends of the edge.
        cell: `[edge, k]` int64, flat in the sender's matrix.
        record: `[edge, k]` float32, what the sender's map holds there.
        valid: `[edge, k]` bool, whether a cell is told at all.
    """

    env: Tensor
    hearer: Tensor
    sender: Tensor
    cell: Tensor
    record: Tensor
    valid: Tensor


def begin_exchange_(state: State) -> None:
    """Add what an exchange keeps to worlds at the start of their episodes."""
    num_envs, n_agents = state.position.shape[:2]
    state.said = torch.zeros_like(state.record)
    state.changed_at = torch.zeros_like(state.record, dtype=torch.int32)
    state.heard_from = torch.full_like(state.record, NOBODY, dtype=torch.int8)
    state.told_until = torch.full(
        (num_envs, n_agents, n_agents), -1, dtype=torch.int64, device=state.record.device
    )
    state.exchanged_bits = torch.zeros_like(state.position[..., 0])


@torch.compiler.disable  # as many rows as there are edges: another number in each step
def exchange_(
    state: State, contact: Bool[Tensor, "env agent agent"], exchange: Exchange, rules: Rules
) -> None:
    """Let robots in contact tell each other what changed, all from their maps before the step.

    Of several records of a cell that of the later step wins, of equals blocked, as in
    `merge_maps`.
    """
    assert state.said is not None and state.changed_at is not None
    assert state.heard_from is not None
    content = what_is_said(state.record, rules)
    changed = content != state.said
    now = state.step.to(torch.int32)[:, None, None, None]
    state.said = content
    state.changed_at = torch.where(changed, now, state.changed_at)
    state.heard_from = torch.where(changed, NOBODY, state.heard_from)
    told = choose_cells_(state, contact, exchange)
    state.exchanged_bits = bits_of(state, told, exchange)
    _hear_(state, told, rules)


def what_is_said(
    record: Float[Tensor, "env agent height width"], rules: Rules
) -> Float[Tensor, "env agent height width"]:
    """Return what maps say of cells, in numbers that are equal where they say the same.

    With decay the step of a cleaning is part of it. Without: 0 unknown, -1 blocked, 1 known and
    never cleaned, 2 cleaned.
    """
    if rules.decay_steps is not None:
        return record.clone()
    return record.sign() * torch.where(is_known_uncleaned(record) | (record < 0), 1.0, 2.0)


def choose_cells_(
    state: State, contact: Bool[Tensor, "env agent agent"], exchange: Exchange
) -> Told:
    """Return what is told over each edge, and note how far each robot has told each other."""
    assert state.changed_at is not None and state.heard_from is not None
    assert state.told_until is not None
    env, hearer, sender = contact.nonzero().unbind(-1)
    size = state.record[0, 0].numel()
    record = state.record.flatten(2)[env, sender]
    order = state.changed_at.flatten(2)[env, sender].long() * size
    order += torch.arange(size, device=order.device)
    until = state.told_until[env, hearer, sender]
    tells = (record != UNKNOWN_RECORD) & (order > until[:, None])
    tells &= state.heard_from.flatten(2)[env, sender] != hearer[:, None]
    last = torch.iinfo(torch.int64).max
    first = torch.where(tells, order, last).topk(min(exchange.cells, size), largest=False)
    valid = first.values != last
    cell = torch.where(valid, first.values % size, 0)
    furthest = torch.where(valid, first.values, -1).amax(-1)
    state.told_until = state.told_until.index_put((env, hearer, sender), furthest.maximum(until))
    return Told(env, hearer, sender, cell, record.gather(1, cell), valid)


def bits_of(state: State, told: Told, exchange: Exchange) -> Int[Tensor, "env agent"]:
    """Return the bits that each robot sends in this step.

    Over every edge the number of cells, 0 to `exchange.cells`; for each cell its place among
    those of the house and the ring around it, two bits for what it is (blocked, dirty or cleaned),
    and the step at which that was learnt, among those of the episode.
    """
    places = ((state.rows + 2) * (state.cols + 2) - 1).to(torch.float64)
    address = places.log2().floor().long() + 1
    steps = state.max_steps.to(torch.float64).log2().floor().long() + 1
    per_cell = (address + steps + 2)[told.env]
    header = exchange.cells.bit_length()
    bits = header + per_cell * told.valid.sum(-1)
    num_envs, n_agents = state.position.shape[:2]
    flat = torch.zeros(num_envs * n_agents, dtype=torch.int64, device=bits.device)
    flat.index_add_(0, told.env * n_agents + told.sender, bits)
    return flat.view(num_envs, n_agents)


def _hear_(state: State, told: Told, rules: Rules) -> None:
    """Write what is heard into the hearers' maps, in place."""
    assert state.said is not None and state.changed_at is not None
    assert state.heard_from is not None
    n_agents, size = state.record.shape[1], state.record[0, 0].numel()
    index = (told.env * n_agents + told.hearer)[:, None] * size + told.cell
    offered = torch.where(told.valid, recency(told.record), 0.0)
    best = torch.zeros_like(state.record).view(-1)
    best.scatter_reduce_(0, index.flatten(), offered.flatten(), "amax")
    held = state.record.view(-1)[index]
    wins = told.valid & (offered == best[index]) & (offered > recency(held))
    at, value = index[wins], told.record[wins]
    write_records_(state.record, at, value)
    # Of several senders of one record the lowest-numbered counts as the one it is heard from.
    sender = told.sender[:, None].expand_as(index)[wins].to(torch.int8)
    source = torch.full_like(state.heard_from, torch.iinfo(torch.int8).max).view(-1)
    source.scatter_reduce_(0, at, sender, "amin")
    said = state.said.view(-1)
    before = said[at]
    now = what_is_said(value.view(1, 1, 1, -1), rules).view(-1)
    differs = now != before
    at, now = at[differs], now[differs]
    env = at // (n_agents * size)
    said[at] = now
    # Of the next step, so that none of them is before what was told to others in this one.
    state.changed_at.view(-1)[at] = state.step[env].to(torch.int32) + 1
    state.heard_from.view(-1)[at] = source[at]
