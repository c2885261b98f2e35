"""Spills: patches of clean cells that become dirty again while the robots clean.

Which robots learn of one, and what cleaning it pays, are settings (`Spills`). Coverage, and with it
the end of an episode, ignores them.
"""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world.distance import within_steps
from marl_clean.world.dynamics import map_base
from marl_clean.world.random import Purpose, random_below
from marl_clean.world.setup import Setup
from marl_clean.world.shared_map import spilt_record, write_records_
from marl_clean.world.state import State, cell_index


def draw_spill_steps(
    setup: Setup, house: Int[Tensor, " env"], episode: Int[Tensor, " env"]
) -> Int[Tensor, "env spill"]:
    """Draw the steps of an episode's spills, all before any team can have cleaned the house.

    Steps 1 to F // n - 1 (F free cells, n robots; at least 1) are divided into as many equal parts
    as there are spills, and each spill is drawn uniformly from its part. 0, which is never, where a
    part is empty. So no two of a world are at one step.
    """
    count = setup.rules.spills.per_episode
    n_agents = setup.houses.starts.shape[1]
    last = (setup.houses.num_free[house, None] // n_agents - 1).clamp(min=1)
    spill = torch.arange(count, device=house.device)
    first, end = spill * last // count, (spill + 1) * last // count
    words = (setup.env_index[:, None], episode[:, None], Purpose.SPILL, 2 * spill)
    step = 1 + first + random_below((end - first).clamp(min=1), setup.seed, *words)
    return torch.where(end > first, step, 0)


def spill_(state: State, setup: Setup) -> None:
    """Spill where it is due at this step, in place, after all has moved and before maps meet.

    A cell is drawn of those that are clean (cleaned before, not spilt since) with no robot on
    them: it is the middle of a square, of an even one the upper left of its four middle cells. The
    square's cells of that kind become spilt; without any the spill does not happen. Robots near
    enough then know all these cells as available and dirty. Costs the house, in the worlds of
    `worlds_to_spill_in`.
    """
    assert state.spilt is not None and state.spill_steps is not None
    spills, margin = setup.rules.spills, setup.rules.margin
    height, width = state.spilt.shape[1:]
    due = state.spill_steps == state.step[:, None]
    rows = worlds_to_spill_in(due)
    if not len(rows):
        return
    due = due[rows]
    robots = cell_index(state.position[rows], margin, width)
    clean = (state.visited[rows] & ~state.spilt[rows]).flatten(1).scatter(1, robots, False)
    drawn = 2 * due.to(torch.int8).argmax(1) + 1
    words = (setup.env_index[rows], state.episode[rows], Purpose.SPILL, drawn)
    pick = random_below(clean.sum(1), setup.seed, *words)
    middle = (clean.cumsum(1) <= pick[:, None]).sum(1)

    # Cells beyond the matrix are read at its edge, which is blocked and so never clean.
    near = torch.arange(spills.size, device=rows.device) - (spills.size - 1) // 2
    row = (middle[:, None] // width + near).clamp(0, height - 1)
    col = (middle[:, None] % width + near).clamp(0, width - 1)
    cell = (row[:, :, None] * width + col[:, None, :]).flatten(1)
    hit = clean.gather(1, cell) & due.any(1, keepdim=True)

    index = rows[:, None] * (height * width) + cell
    spilt = state.spilt.view(-1)
    spilt.index_put_((index.reshape(-1),), (hit | spilt[index]).reshape(-1))
    for name in ("num_spilt", "num_open_spilt"):
        setattr(state, name, getattr(state, name).index_add(0, rows, hit.sum(1)))
    _notice_(state, rows, cell, hit, _who_notices(state, rows, cell, hit, robots, setup))


def worlds_to_spill_in(due: Bool[Tensor, "env spill"]) -> Int[Tensor, " row"]:
    """Return the worlds with a spill due; all of them on a GPU, which picking would wait for."""
    if due.device.type == "cpu":
        return due.any(1).nonzero()[:, 0]
    return torch.arange(len(due), device=due.device)


def _who_notices(
    state: State,
    rows: Int[Tensor, " row"],
    cell: Int[Tensor, "row cell"],
    hit: Bool[Tensor, "row cell"],
    robots: Int[Tensor, "row agent"],
    setup: Setup,
) -> Bool[Tensor, "row agent"]:
    """Return which robots are within `noticed_within` steps on foot of a spilt cell."""
    most = setup.rules.spills.noticed_within
    if most is None:
        return torch.ones_like(robots, dtype=torch.bool)
    free = ~state.blocked[rows]
    patch = torch.zeros_like(free).flatten(1).scatter(1, cell, hit).view_as(free)
    return within_steps(free, patch, most).flatten(1).gather(1, robots)


def _notice_(
    state: State,
    rows: Int[Tensor, " row"],
    cell: Int[Tensor, "row cell"],
    hit: Bool[Tensor, "row cell"],
    noticed: Bool[Tensor, "row agent"],
) -> None:
    """Write the cells `hit` into the maps of the robots that noticed, in place."""
    if state.record.shape[1] == 1:
        noticed = noticed.any(1, keepdim=True)
    index = map_base(state)[rows][:, :, None] + cell[:, None]
    held = state.record.view(-1)[index]
    now = (state.step[rows] + 1).to(held.dtype)[:, None, None]
    written = noticed[:, :, None] & hit[:, None]
    value = torch.where(written, spilt_record(now), held)
    write_records_(state.record, index.flatten(1), value.flatten(1))
