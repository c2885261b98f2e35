"""The surroundings of a robot at any scale, in numbers that do not grow with the house."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.world.distance import UNREACHABLE, neighbours

BLOCKS = 5  # the side of a grid of blocks


def block_shares(
    mask: Bool[Tensor, "env map height width"], centre: Int[Tensor, "env agent 2"], block: int
) -> Float[Tensor, "env agent 5 5"]:
    """Return what share of each block of `block` x `block` cells around a robot is in `mask`.

    A grid of 5 x 5 blocks, the robot's cell in the middle of the middle block; `centre` are places
    in the matrix. Cells outside the matrix are not in `mask`. Computed from prefix sums, so a block
    costs four reads whatever its size.
    """
    num_envs, n_agents = centre.shape[:2]
    height, width = mask.shape[-2:]
    sums = torch.nn.functional.pad(mask, (1, 0, 1, 0)).to(torch.int32)
    sums = sums.cumsum(-1, dtype=torch.int32).cumsum(-2, dtype=torch.int32).flatten(2)
    edge = block * torch.arange(BLOCKS + 1, device=mask.device) - BLOCKS * block // 2
    row = (centre[..., :1] + edge).clamp(0, height)
    col = (centre[..., 1:] + edge).clamp(0, width)
    corner = (row[..., :, None] * (width + 1) + col[..., None, :]).flatten(2)
    sums = sums.expand(-1, n_agents, -1).gather(2, corner)
    inside = sums.view(num_envs, n_agents, BLOCKS + 1, BLOCKS + 1).diff(dim=-1).diff(dim=-2)
    return inside / block**2


def in_squares(
    offset: Int[Tensor, "env agent agent 2"],
    visible: Bool[Tensor, "env agent agent"],
    squares: int,
    side: int,
) -> Float[Tensor, "env agent row col"]:
    """Mark which of `squares` x `squares` squares of `side` cells around a robot hold others.

    1 where at least one `visible` robot stands; the robot itself is in the middle.
    """
    place = (offset + squares * side // 2).div(side, rounding_mode="floor")
    inside = visible & (place >= 0).all(-1) & (place < squares).all(-1)
    index = torch.where(inside, place[..., 0] * squares + place[..., 1], squares**2)
    marks = torch.zeros((*offset.shape[:2], squares**2 + 1), device=offset.device)
    marks = marks.scatter(2, index, 1.0)  # robots outside go beyond the end
    return marks[..., :-1].unflatten(-1, (squares, squares))


def closer_steps(
    distance: Int[Tensor, "env map height width"], cell: Int[Tensor, "env agent"]
) -> tuple[Bool[Tensor, "env agent 4"], Int[Tensor, "env agent"]]:
    """Return which actions bring each robot nearer, and its own distance; `cell` is flat."""
    n_agents = cell.shape[1]
    every = torch.cat([distance[None], neighbours(distance, UNREACHABLE)])
    every = every.flatten(3).expand(-1, -1, n_agents, -1)
    own, *beside = every.gather(3, cell[None, :, :, None].expand(5, -1, -1, -1))[..., 0]
    return torch.stack([distance < own for distance in beside], -1), own


def walls_beside(
    blocked: Bool[Tensor, "env map height width"],
) -> tuple[Bool[Tensor, "4 env map height width"], Bool[Tensor, "4 env map height width"]]:
    """Return where the next cell up, right, down, left is blocked, and where the next two are."""
    next_cell = neighbours(blocked, False)
    beyond = torch.stack([neighbours(side, False)[i] for i, side in enumerate(next_cell)])
    return next_cell, next_cell & beyond


def continues_wall(
    blocked: Bool[Tensor, "env map height width"],
) -> Bool[Tensor, "env map height width"]:
    """Return which cells lie in line with two known walls, in a row or a column."""
    next_cell, next_two = walls_beside(blocked)
    between = (next_cell[0] & next_cell[2]) | (next_cell[1] & next_cell[3])
    return next_two.any(0) | between
