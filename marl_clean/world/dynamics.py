"""The robots' moves, and what a step changes in the map (paper §3.2).

Matrices are written by `index_put_`, which compiled code does in place too; `scatter_` would copy
them.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.settings import PaidBy
from marl_clean.world.rewards import collision_term, reward_terms, spill_term
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import spilt_record, union_of_maps, write_records_
from marl_clean.world.state import State, cell_index

# Change of (row, col) by action: 0 up, 1 right, 2 down, 3 left.
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))


class Outcome(NamedTuple):
    """What one step brings."""

    position: Int[Tensor, "env agent 2"]
    moved: Bool[Tensor, "env agent"]
    bumped: Bool[Tensor, "env agent"]
    collided: Bool[Tensor, "env agent"]
    newly_cleaned: Bool[Tensor, "env agent"]
    step_term: Float[Tensor, "env agent 1"]
    cleaning_term: Float[Tensor, "env agent 1"]
    discovery_term: Float[Tensor, "env agent 1"]
    collision_term: Float[Tensor, "env agent 1"] | None  # None without `collision_pays`
    own_reward: Float[Tensor, "env agent 1"]  # the sum of the terms
    step: Int[Tensor, " env"]
    last_progress: Int[Tensor, " env"]
    num_visited: Int[Tensor, " env"]
    visited_index: Int[Tensor, "env agent"]  # flat over State.visited
    record_index: Int[Tensor, "env entry"]  # flat over State.record
    record_value: Float[Tensor, "env entry"]
    spill_term: Float[Tensor, "env agent 1"] | None = None  # and the next: None without spills
    num_open_spilt: Int[Tensor, " env"] | None = None


def moves_on(device: torch.device) -> Int[Tensor, "4 2"]:
    """Return MOVES as a tensor, made on the device: a copy of a list would be waited for."""
    action = torch.arange(len(MOVES), device=device)
    sideways = action % 2
    return torch.stack([(action - 1) * (1 - sideways), (2 - action) * sideways], -1)


def advance_(
    state: State,
    action: Int[Tensor, "env agent"],
    moves: Int[Tensor, "4 2"],
    rules: Rules,
    unnoticed: Bool[Tensor, "env agent"] | None = None,
) -> Outcome:
    """Move all robots at once, in place, and value what they do against the map before the step.

    A robot moves when its target is free, no robot stood there when the step began, and no
    lower-numbered robot enters it in this step. Of several robots with one free, empty target
    the lowest-numbered always gets it, so the last condition is: no lower number has this target.
    A bump in `unnoticed` counts as one, but writes nothing and pays nothing. What maps show beside
    their own, lent or heard, is taken back first.
    """
    if state.own_record is not None:
        state.record = state.own_record
    num_envs, n_agents = action.shape
    height, width = state.blocked.shape[1:]
    target = state.position + moves[action]
    own_cell = cell_index(state.position, rules.margin, width)
    target_cell = cell_index(target, rules.margin, width)

    bumped = state.blocked.flatten(1).gather(1, target_cell)
    taken = (target_cell[:, :, None] == own_cell[:, None, :]).any(-1)
    same_target = target_cell[:, :, None] == target_cell[:, None, :]
    lower = torch.ones((n_agents, n_agents), dtype=torch.bool, device=action.device).tril(-1)
    collided = ~bumped & (taken | (same_target & lower).any(-1))
    moved = ~bumped & ~collided
    position = torch.where(moved[..., None], target, state.position)
    cell = torch.where(moved, target_cell, own_cell)

    now = (state.step + 1).to(state.record.dtype)[:, None]
    held = valued_records(state, target_cell, rules)
    noticed = bumped if unnoticed is None else bumped & ~unnoticed
    spilt = spills = num_open_spilt = None
    if state.spilt is not None and state.num_open_spilt is not None:
        spilt = moved & state.spilt.flatten(1).gather(1, cell)
        spills = spill_term(spilt, rules)
        num_open_spilt = state.num_open_spilt - spilt.sum(-1)
    terms = reward_terms(held, now, moved, noticed, rules, spilt)
    step_term, cleaning_term, discovery_term = terms
    own_reward = step_term + cleaning_term + discovery_term
    collision = collision_term(collided, rules) if rules.collision_pays else None
    for further in (collision, spills):
        if further is not None:
            own_reward = own_reward + further

    step = state.step + 1
    newly_cleaned = ~state.visited.flatten(1).gather(1, cell)
    progress = newly_cleaned.any(-1)
    written = (step + 1).to(state.record.dtype)[:, None].expand(num_envs, n_agents)
    bump_or_own = torch.where(noticed, target_cell, cell)
    base = map_base(state)
    envs = torch.arange(num_envs, device=action.device)[:, None]
    outcome = Outcome(
        position=position,
        moved=moved,
        bumped=bumped,
        collided=collided,
        newly_cleaned=newly_cleaned,
        step_term=step_term[..., None],
        cleaning_term=cleaning_term[..., None],
        discovery_term=discovery_term[..., None],
        collision_term=None if collision is None else collision[..., None],
        own_reward=own_reward[..., None],
        step=step,
        last_progress=torch.where(progress, step, state.last_progress),
        num_visited=state.num_visited + newly_cleaned.sum(-1),
        visited_index=envs * (height * width) + cell,
        record_index=torch.cat([base + cell, base + bump_or_own], -1),
        record_value=torch.cat([written, torch.where(noticed, -written, written)], -1),
        spill_term=None if spills is None else spills[..., None],
        num_open_spilt=num_open_spilt,
    )
    _commit_(state, outcome)
    return outcome


def valued_records(
    state: State, cell: Int[Tensor, "env agent"], rules: Rules
) -> Float[Tensor, "env agent"]:
    """Return what the map by which a step pays holds of one cell a robot (`paid_by`)."""
    maps = state.record.flatten(2)
    if rules.paid_by is PaidBy.OWN_MAP or maps.shape[1] == 1:
        return held_records(state, cell)
    return union_of_maps(maps.gather(2, cell[:, None].expand(-1, maps.shape[1], -1)))


def held_records(state: State, cell: Int[Tensor, "env agent"]) -> Float[Tensor, "env agent"]:
    """Return what the map that each robot reads holds of one cell a robot."""
    record = state.record.flatten(2).expand(-1, state.n_agents, -1)
    return record.gather(2, cell[..., None])[..., 0]


def map_base(state: State) -> Int[Tensor, "env map_or_1"]:
    """Return where each robot's map starts in the flattened records, [env, agent] or [env, 1]."""
    num_envs, num_maps, height, width = state.record.shape
    maps = torch.arange(num_envs * num_maps, device=state.record.device)
    return maps.view(num_envs, num_maps) * (height * width)


def _commit_(state: State, outcome: Outcome) -> None:
    for name in ("position", "moved", "bumped", "collided", "newly_cleaned"):
        setattr(state, name, getattr(outcome, name))
    for name in ("step", "last_progress", "num_visited"):
        setattr(state, name, getattr(outcome, name))
    true = torch.ones((), dtype=torch.bool, device=state.visited.device)
    cell = (outcome.visited_index.reshape(-1),)
    state.visited.view(-1).index_put_(cell, true)
    if state.spilt is not None:
        state.num_open_spilt = outcome.num_open_spilt
        state.spilt.view(-1).index_put_(cell, ~true)
    write_records_(state.record, outcome.record_index, outcome.record_value)


def touch_(state: State, rules: Rules) -> None:
    """Write the four neighbours of every robot into its map (`sensor=touch4`).

    Walls are written as bumps write them; free cells not yet known to be available become
    available and dirty; known available ones are left as they are, spilt ones apart, which are
    noticed.
    """
    num_envs, n_agents = state.position.shape[:2]
    beside = cells_beside(state, rules)
    cell, held = beside.flatten(1), records_beside(state, beside).flatten(1)
    blocked = state.blocked.flatten(1).gather(1, cell)
    now = (state.step + 1).to(held.dtype)[:, None]
    learnt = torch.where(blocked, -now, torch.where(held > 0, held, now - 0.5))
    if state.spilt is not None:
        learnt = torch.where(state.spilt.flatten(1).gather(1, cell), spilt_record(now), learnt)
    base = map_base(state).expand(num_envs, n_agents).repeat_interleave(4, -1)
    write_records_(state.record, base + cell, learnt)


def note_robots_(state: State, contact: Bool[Tensor, "env agent agent"], rules: Rules) -> None:
    """Write into every private map where the robots in contact stand (`robots_noted`).

    They clean where they stand, so the cell is written as the own one is, in lent maps too.
    """
    cell = cell_index(state.position, rules.margin, state.blocked.shape[2])
    index = (map_base(state)[..., None] + cell[:, None]).flatten(1)
    now = (state.step + 1).to(state.record.dtype)[:, None]
    for maps in (state.record, *([] if state.own_record is None else [state.own_record])):
        held = maps.view(-1)[index]
        write_records_(maps, index, torch.where(contact.flatten(1), now, held))


def cells_beside(state: State, rules: Rules) -> Int[Tensor, "env agent 4"]:
    """Return the flat indices of each robot's up, right, down and left neighbour."""
    around = state.position[:, :, None] + moves_on(state.position.device)
    return cell_index(around, rules.margin, state.blocked.shape[2])


def records_beside(
    state: State, beside: Int[Tensor, "env agent 4"]
) -> Float[Tensor, "env agent 4"]:
    """Return what the map that each robot reads holds of its `cells_beside`."""
    return state.record.flatten(2).expand(-1, state.n_agents, -1).gather(2, beside)


def episode_ends(
    state: State, stuck_after: int | None
) -> tuple[Bool[Tensor, " env"], Bool[Tensor, " env"]]:
    """Return (terminated, truncated): all clean; or out of steps or stuck (paper §3.4)."""
    terminated = state.num_visited >= state.num_free
    truncated = state.step >= state.max_steps
    if stuck_after is not None:
        truncated = truncated | (state.step - state.last_progress >= stuck_after)
    return terminated, truncated & ~terminated
