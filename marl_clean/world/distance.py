"""Walking distances over grids, for planners, bounds and connectivity.

These cost the whole house times the longest way; no hot path of the world calls them.
"""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

UNREACHABLE = 1 << 30


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


@torch.compiler.disable  # a loop as long as the longest path; called as it is
def walking_distance(
    passable: Bool[Tensor, "*batch height width"], sources: Bool[Tensor, "*batch height width"]
) -> Int[Tensor, "*batch height width"]:
    """Return the steps from the nearest source to each cell, over passable cells.

    Sources are at 0 whether passable or not; cells that no way leads to are UNREACHABLE, and so
    are impassable ones that are no source. int32.
    """
    distance = torch.where(sources, 0, UNREACHABLE).to(torch.int32)
    frontier = sources
    unreached = passable & ~sources
    steps = 0
    while frontier.any():
        steps += 1
        frontier = neighbours(frontier, False).any(0) & unreached
        unreached = unreached & ~frontier
        distance = torch.where(frontier, steps, distance)
    return distance


def is_connected(free: Bool[Tensor, "*batch height width"]) -> Bool[Tensor, "*batch"]:
    """Tell which grids have one connected free region (or none)."""
    flat = free.flatten(-2)
    first = flat.to(torch.int8).argmax(-1, keepdim=True)
    source = torch.zeros_like(flat).scatter(-1, first, True).view(free.shape) & free
    return ~((walking_distance(free, source) == UNREACHABLE) & free).flatten(-2).any(-1)
