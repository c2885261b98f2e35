"""Walking distances over grids, for planners, bounds, connectivity and what robots see.

On a CPU a search is machine code that visits a cell once; elsewhere a flood, whose every step is
over all cells of all grids at once. Both give the same numbers.
"""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world import searches
from marl_clean.world.floods import flood, flood_first_steps, flood_within
from marl_clean.world.searches import UNREACHABLE


def neighbours(matrix: Tensor, outside: bool | int) -> Tensor:
    """Stack each cell's up, right, down and left neighbour: [..., h, w] to [4, ..., h, w]."""
    padded = torch.nn.functional.pad(matrix, (1, 1, 1, 1), value=outside)
    height, width = matrix.shape[-2:]
    return torch.stack(
        [
            padded[..., 0:height, 1 : width + 1],
            padded[..., 1 : height + 1, 2 : width + 2],
            padded[..., 2 : height + 2, 1 : width + 1],
            padded[..., 1 : height + 1, 0:width],
        ]
    )


@torch.compiler.disable  # machine code, or a loop as long as the longest path; called as it is
def walking_distance(
    passable: Bool[Tensor, "*batch height width"], sources: Bool[Tensor, "*batch height width"]
) -> Int[Tensor, "*batch height width"]:
    """Return the steps from the nearest source to each cell, over passable cells.

    Sources are at 0 whether passable or not; cells that no way leads to are UNREACHABLE, and so
    are impassable ones that are no source. int32.
    """
    if passable.device.type != "cpu":
        return flood(passable, sources)
    passable, sources = torch.broadcast_tensors(passable, sources)
    height, width = passable.shape[-2:]
    grids = (grid.reshape(-1, height, width).numpy() for grid in (passable, sources))
    return torch.from_numpy(searches.distances(*grids)).view(passable.shape)


@torch.compiler.disable
def within_steps(
    passable: Bool[Tensor, "*batch height width"],
    sources: Bool[Tensor, "*batch height width"],
    most: int,
) -> Bool[Tensor, "*batch height width"]:
    """Return which cells `walking_distance` has at most `most` steps from a source."""
    if passable.device.type != "cpu":
        return flood_within(passable, sources, most)
    return walking_distance(passable, sources) <= most


@torch.compiler.disable
def first_steps(
    passable: Bool[Tensor, "env map height width"],
    goals: Bool[Tensor, "env map height width"],
    start: Int[Tensor, "env agent"],
    others: Int[Tensor, "env agent"],
    rivals: Bool[Tensor, "env agent agent"],
) -> tuple[Bool[Tensor, "env agent 4"], Int[Tensor, "env agent"]]:
    """Return which first steps lead to each robot's nearest goal, and how many steps it takes.

    Of the goals at 1 step or more to which none of the robot's `rivals` is nearer, over passable
    cells of the one map or of the robot's own; goals and starts need not be passable, and robots
    block no path. All shortest paths to all such goals at that distance count. No step, and
    UNREACHABLE, where there is none. `start` and `others` are flat cells of the grid: where each
    robot begins, and where robots stand for each other. int32.
    """
    if passable.device.type != "cpu":
        return flood_first_steps(passable, goals, start, others, rivals)
    passable, goals = torch.broadcast_tensors(passable, goals)
    arrays = (each.contiguous().numpy() for each in (passable, goals, start, others, rivals))
    ways, lengths = searches.first_steps(*arrays)
    return torch.from_numpy(ways), torch.from_numpy(lengths)


def is_connected(free: Bool[Tensor, "*batch height width"]) -> Bool[Tensor, "*batch"]:
    """Tell which grids have one connected free region (or none)."""
    flat = free.flatten(-2)
    first = flat.to(torch.int8).argmax(-1, keepdim=True)
    source = torch.zeros_like(flat).scatter(-1, first, True).view(free.shape) & free
    return ~((walking_distance(free, source) == UNREACHABLE) & free).flatten(-2).any(-1)
