"""Furniture that is moved while the robots clean (paper §3.1)."""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world.distance import is_connected
from marl_clean.world.dynamics import MOVES
from marl_clean.world.state import State, cell_index


def shift_piece(
    blocked: Bool[Tensor, "env height width"],
    piece: Int[Tensor, "env height width"],
    inside: Bool[Tensor, "env height width"],
    occupied: Bool[Tensor, "env height width"],
    which: Int[Tensor, " env"],
    direction: Int[Tensor, " env"],
) -> tuple[Bool[Tensor, "env height width"], Int[Tensor, "env height width"]]:
    """Shift one piece a world by one cell and return the new (blocked, piece).

    A move that would leave the house, hit a wall, another piece or a robot (`occupied`), or cut
    the free cells in two is skipped, and so is one of piece 0.
    """
    old = (piece == which[:, None, None]) & (which > 0)[:, None, None]
    shifts = torch.stack([torch.roll(old, move, (1, 2)) for move in MOVES], 1)
    new = shifts[torch.arange(len(old), device=old.device), direction]
    obstacle = (blocked & ~old) | occupied | ~inside
    new_blocked = (blocked & ~old) | new
    allowed = ~(new & obstacle).flatten(1).any(1) & is_connected(~new_blocked)
    allowed = (allowed & old.flatten(1).any(1))[:, None, None]
    new_piece = torch.where(new, which[:, None, None].to(piece.dtype), torch.where(old, 0, piece))
    return torch.where(allowed, new_blocked, blocked), torch.where(allowed, new_piece, piece)


def inside_house(
    rows: Int[Tensor, " env"], cols: Int[Tensor, " env"], height: int, width: int, margin: int
) -> Bool[Tensor, "env height width"]:
    """Tell which cells of the padded matrices belong to the house, ring excluded."""
    row = torch.arange(height, device=rows.device)[None, :, None] - margin
    col = torch.arange(width, device=rows.device)[None, None, :] - margin
    row_inside = (row >= 0) & (row < rows[:, None, None])
    return row_inside & (col >= 0) & (col < cols[:, None, None])


def move_furniture_(state: State, margin: int) -> None:
    """Carry out the moves that are due at this step, in the order of the list, in place.

    A vacated cell is dirty; what the robots believe does not change. Costs the house, in the
    worlds with a move due only.
    """
    height, width = state.blocked.shape[1:]
    for move in range(state.furniture_moves.shape[1]):
        due_step, which, direction = state.furniture_moves[:, move].unbind(-1)
        rows = (due_step == state.step).nonzero()[:, 0]
        if not len(rows):
            continue
        cells = cell_index(state.position[rows], margin, width)
        occupied = torch.zeros_like(state.blocked[rows]).flatten(1).scatter(1, cells, True)
        blocked, piece = shift_piece(
            state.blocked[rows],
            state.piece[rows],
            inside_house(state.rows[rows], state.cols[rows], height, width, margin),
            occupied.view(-1, height, width),
            which[rows],
            direction[rows],
        )
        unchanged = blocked == state.blocked[rows]
        state.visited[rows] &= unchanged
        if state.spilt is not None and state.num_open_spilt is not None:  # a piece can cover them
            state.spilt[rows] &= unchanged
            state.num_open_spilt[rows] = state.spilt[rows].flatten(1).sum(1)
        state.blocked[rows], state.piece[rows] = blocked, piece
        state.num_visited[rows] = state.visited[rows].flatten(1).sum(1)
