"""The map around a robot at coarser and coarser scales, and the whole of it."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from marl_clean.world.rules import (
    BLOCKED_VALUE,
    CLEANED_VALUE,
    ROBOT_VALUE,
    UNKNOWN_VALUE,
    Rules,
)
from marl_clean.world.shared_map import UNKNOWN_RECORD, shown_value

PLANES_A_SCALE = 4


def widest_side(view_size: int, scales: int) -> int:
    """The side of the square of cells that the coarsest of `scales` scales looks at, odd."""
    return view_size * 2 ** (scales - 1) + 1


def wide_crop(
    record: Float[Tensor, "env map height width"],
    position: Int[Tensor, "env agent 2"],
    step: Int[Tensor, " env"],
    side: int,
    rules: Rules,
) -> Float[Tensor, "env agent side side"]:
    """Return the square of the map around each robot, however far it reaches over the matrix.

    As `sensing.crop`, for views wider than the margin: cell by cell, and what lies outside the
    matrix is read from its edge. Needs `rules.margin >= 2`, so that this edge is never written.
    """
    num_envs, num_maps, height, width = record.shape
    reach = torch.arange(side, device=record.device) - side // 2 + rules.margin
    row = (position[..., 0, None] + reach).clamp(0, height - 1)
    col = (position[..., 1, None] + reach).clamp(0, width - 1)
    cell = row[..., :, None] * width + col[..., None, :]
    maps = record.flatten(2)  # one for all, or one each
    view = maps.gather(2, cell.view(num_envs, num_maps, -1)).view(cell.shape)
    now = (step + 1).to(record.dtype).view(-1, 1, 1, 1)
    return shown_value(view, now, rules)


def coarser(
    code: Float[Tensor, "env agent side side"], view_size: int, scales: int
) -> Float[Tensor, "env agent plane view view"]:
    """Return every scale but the finest of a `wide_crop`, four planes each, finer ones first.

    An entry of scale s stands for 2^s x 2^s cells, the robot's cell in the middle of the middle
    one: two entries share the cells on their border, half each. Its planes: the share of these
    cells that is blocked, the share that is unknown, their dirt (1 - 2 v of an available cell, of
    others 0) on average, and whether there is a robot.
    """
    num_envs, n_agents, side, _ = code.shape
    square = code.flatten(0, 1)
    available = (square >= 0) & (square <= CLEANED_VALUE)
    dirt = torch.where(available, 1 - square / CLEANED_VALUE, 0.0)
    planes = torch.stack([square == BLOCKED_VALUE, square == UNKNOWN_VALUE, dirt], 1)
    robot = (square == ROBOT_VALUE).to(code.dtype)[:, None]
    coarse = []
    for scale in range(1, scales):
        cells = 2**scale
        first = (side - view_size * cells) // 2
        middle = slice(first, side - first)
        part = _parts(view_size, cells, code.device)
        coarse.append(part @ planes[..., middle, middle] @ part.mT)
        seen = torch.nn.functional.max_pool2d(robot[..., middle, middle], cells + 1, stride=cells)
        coarse.append(seen)
    return torch.cat(coarse, 1).unflatten(0, (num_envs, n_agents))


def _parts(entries: int, cells: int, device: torch.device) -> Float[Tensor, "entry cell"]:
    """Return what part of each entry a cell of its row is: half as much on a border."""
    entry = torch.arange(entries, device=device)[:, None]
    cell = torch.arange(entries * cells + 1, device=device)
    inside = torch.minimum(cell - entry * cells, (entry + 1) * cells - cell)
    return (inside + 0.5).clamp(0, 1) / cells


def whole_map(
    record: Float[Tensor, "env map height width"],
    step: Int[Tensor, " env"],
    largest_side: int,
    rules: Rules,
) -> Float[Tensor, "env map side side"]:
    """Return the whole map of each house, its ring first; unknown up to the largest house."""
    side, ring = largest_side + 2, rules.margin - 1
    matrix = record[..., ring : ring + side, ring : ring + side]
    missing = (0, side - matrix.shape[-1], 0, side - matrix.shape[-2])
    matrix = torch.nn.functional.pad(matrix, missing, value=UNKNOWN_RECORD)
    return shown_value(matrix, (step + 1).to(record.dtype).view(-1, 1, 1, 1), rules)


def marked(
    position: Int[Tensor, "env agent 2"], largest_side: int
) -> Float[Tensor, "env agent side side"]:
    """Return a plane a robot: 1 where it stands in its `whole_map`, else 0."""
    side = largest_side + 2
    cell = (position[..., 0] + 1) * side + position[..., 1] + 1
    plane = torch.zeros((*cell.shape, side * side), device=position.device)
    return plane.scatter(2, cell[..., None], 1.0).unflatten(2, (side, side))
