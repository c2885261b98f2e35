"""Which cell each robot has to clean next, by its map."""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world.distance import UNREACHABLE, walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.rules import Rules
from marl_clean.world.searches import GOAL, fill_grid, machine_code
from marl_clean.world.shared_map import is_known_free, is_known_uncleaned, is_unknown
from marl_clean.world.state import State

NONE = -1


def nearest_targets(
    state: State, rules: Rules
) -> tuple[Int[Tensor, "env agent 2"], Int[Tensor, "env agent 1"]]:
    """Return (row, col) of each robot's nearest target, and 1; without one any place, and 0.

    A target is a cell of the house that the robot's map does not know, or knows to be available
    and not cleaned in this episode. Paths lead over cells known to be available. Among those
    nearest on foot it is the first, row by row.
    """
    margin = rules.margin
    height, width = (size - 2 * margin for size in state.record.shape[-2:])
    record = state.record[..., margin : margin + height, margin : margin + width]
    house = inside_house(state.rows, state.cols, height, width, margin=0)[:, None]
    passable = is_known_free(record)
    goals = (is_unknown(record) & house) | is_known_uncleaned(record)
    start = state.position[..., 0] * width + state.position[..., 1]
    cell = nearest_goals(passable, goals, start).unsqueeze(-1)
    place = torch.cat([cell.div(width, rounding_mode="floor"), cell % width], dim=-1)
    return place, cell.ne(NONE).to(torch.int64)


@torch.compiler.disable  # machine code, or a loop as long as the longest path; called as it is
def nearest_goals(
    passable: Bool[Tensor, "env map height width"],
    goals: Bool[Tensor, "env map height width"],
    start: Int[Tensor, "env agent"],
) -> Int[Tensor, "env agent"]:
    """Return the flat cell of the goal nearest to each start, the lowest of several; -1: none.

    Ways lead over passable cells, and end at the goal, passable or not. One map serves all starts,
    or each its own.
    """
    if passable.device.type == "cpu":
        arrays = (passable.numpy(), goals.numpy(), start.numpy())
        return torch.from_numpy(_nearest_goals(*arrays))
    return flooded_goals(passable, goals, start)


def flooded_goals(
    passable: Bool[Tensor, "env map height width"],
    goals: Bool[Tensor, "env map height width"],
    start: Int[Tensor, "env agent"],
) -> Int[Tensor, "env agent"]:
    """Return what `nearest_goals` does, by a flood from every start, on any device."""
    robots, cells = start.shape[1], passable[0, 0].numel()
    shape = (len(start), robots, *passable.shape[-2:])
    begun = torch.nn.functional.one_hot(start, cells).bool().view(shape)
    # A way may lead on through a goal here: what lies behind it is farther than the goal itself.
    distance = walking_distance((passable | goals).expand(shape), begun)
    distance = distance.masked_fill(~goals.expand(shape), UNREACHABLE).flatten(-2)
    nearest, cell = distance.min(-1)
    return cell.masked_fill(nearest == UNREACHABLE, NONE)


@machine_code
@no_type_check
def _nearest_goals(passable: np.ndarray, goals: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Search from each start until the goals at the least distance are reached."""
    envs, robots = starts.shape
    maps, rows, cols = passable.shape[1:]
    stride = cols + 2
    result = np.full((envs, robots), NONE, np.int64)
    grid = np.zeros((rows + 2) * stride, np.uint8)
    steps = np.full((rows + 2) * stride, -1, np.int32)
    queue = np.empty(rows * cols, np.int32)
    for env in range(envs):
        for robot in range(robots):
            if robot < maps:
                fill_grid(grid, stride, passable[env, robot], goals[env, robot])
            cell = starts[env, robot]
            queue[0] = (cell // cols + 1) * stride + cell % cols + 1
            steps[queue[0]] = 0
            head, tail, nearest = 0, 1, -1
            while head < tail:
                cell = queue[head]
                head += 1
                if nearest >= 0 and steps[cell] > nearest:
                    break
                if grid[cell] & GOAL:
                    flat = (cell // stride - 1) * cols + cell % stride - 1
                    if nearest < 0 or flat < result[env, robot]:
                        result[env, robot] = flat
                    nearest = steps[cell]
                    continue
                for beside in (cell - stride, cell + 1, cell + stride, cell - 1):
                    if steps[beside] < 0 and grid[beside]:
                        steps[beside] = steps[cell] + 1
                        queue[tail] = beside
                        tail += 1
            for index in range(tail):
                steps[queue[index]] = -1
    return result
