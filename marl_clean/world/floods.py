"""Searches over grids by tensor operations: all cells of all grids advance at once, on any device.

A row of a grid is a few integers, one bit a cell, so a step is shifts and bitwise operations on
a small part of the memory that a number for each cell would take. The machine code of `searches`
gives the same numbers on a CPU.
"""

from itertools import count

import torch
from jaxtyping import Bool, Int
from torch import Tensor
from torch.nn.functional import pad

from marl_clean.world.searches import UNREACHABLE

STEPS_BETWEEN_LOOKS = 16  # the host waits to learn whether a flood continues, on a GPU
CELLS = 62  # of a row in one int64: a shift to either side meets neither the sign nor the end


def flood(
    passable: Bool[Tensor, "*batch height width"], sources: Bool[Tensor, "*batch height width"]
) -> Int[Tensor, "*batch height width"]:
    """Return what `walking_distance` does."""
    width = sources.shape[-1]
    wave = packed(sources)
    unreached = packed(passable & ~sources)
    digits: list[Tensor] = []  # of the distances, in base 2: which cells have a 1 there
    for steps in count(1):
        wave = beside(wave) & unreached
        unreached = unreached ^ wave
        for digit in range(steps.bit_length()):
            if digit == len(digits):
                digits.append(torch.zeros_like(wave))
            if steps >> digit & 1:
                digits[digit] |= wave
        if steps % STEPS_BETWEEN_LOOKS == 0 and not wave.any():
            break
    distance = torch.zeros(unreached.shape[:-1] + (width,), dtype=torch.int32, device=wave.device)
    for digit, ones in enumerate(digits):
        distance += unpacked(ones, width) * 2**digit
    return distance.masked_fill_((distance == 0) & ~sources, UNREACHABLE)


def flood_within(
    passable: Bool[Tensor, "*batch height width"],
    sources: Bool[Tensor, "*batch height width"],
    most: int,
) -> Bool[Tensor, "*batch height width"]:
    """Return what `within_steps` does; below STEPS_BETWEEN_LOOKS steps nothing is waited for."""
    wave = reached = packed(sources)
    unreached = packed(passable & ~sources)
    for steps in range(1, most + 1):
        wave = beside(wave) & unreached
        unreached, reached = unreached ^ wave, reached | wave
        if steps % STEPS_BETWEEN_LOOKS == 0 and not wave.any():
            break
    return unpacked(reached, sources.shape[-1]) > 0


def flood_first_steps(
    passable: Bool[Tensor, "env map height width"],
    goals: Bool[Tensor, "env map height width"],
    start: Int[Tensor, "env agent"],
    others: Int[Tensor, "env agent"],
    rivals: Bool[Tensor, "env agent agent"],
) -> tuple[Bool[Tensor, "env agent 4"], Int[Tensor, "env agent"]]:
    """Return what `first_steps` does."""
    height, width = passable.shape[-2:]

    def marked(cell: Int[Tensor, "env agent"]) -> Bool[Tensor, "env agent cell"]:
        place = torch.zeros((*cell.shape, height * width), dtype=torch.bool, device=cell.device)
        return place.scatter(2, cell[..., None], True)

    own = marked(start)
    of_rivals = (rivals.float() @ marked(others).float()) > 0
    wave = packed((own | of_rivals).unflatten(-1, (height, width)))
    # Which cells of a robot's wave it came to by which first step, [env, agent, 4, height, word].
    by_step = packed(entered(own.unflatten(-1, (height, width))))
    onward, targets = packed(passable), packed(goals)
    open_cells, reached = onward | targets, wave
    ways = torch.zeros((*start.shape, 4), dtype=torch.bool, device=start.device)
    lengths = torch.full(start.shape, UNREACHABLE, dtype=torch.int32, device=start.device)
    for steps in count(1):
        if steps > 1:
            wave = wave & onward
            by_step = beside(by_step & onward[:, :, None])
        wave = beside(wave) & open_cells & ~reached
        reached = reached | wave
        by_step = by_step & wave[:, :, None]
        at_goal = (by_step & targets[:, :, None]).flatten(3).any(-1)
        first = at_goal.any(-1) & (lengths == UNREACHABLE)
        ways |= at_goal & first[..., None]
        lengths = torch.where(first, steps, lengths)
        if steps % STEPS_BETWEEN_LOOKS:
            continue
        if not (wave.flatten(2).any(-1) & (lengths == UNREACHABLE)).any():
            break
    return ways, lengths


def entered(
    cell: Bool[Tensor, "env agent height width"],
) -> Bool[Tensor, "env agent 4 height width"]:
    """Return the cells that a step up, right, down and left leads to from the marked ones."""
    around = pad(cell, (1, 1, 1, 1))
    up, down = around[..., 2:, 1:-1], around[..., :-2, 1:-1]
    right, left = around[..., 1:-1, :-2], around[..., 1:-1, 2:]
    return torch.stack([up, right, down, left], 2)


def packed(cells: Bool[Tensor, "*batch height width"]) -> Int[Tensor, "*batch height word"]:
    """Write CELLS cells of a row as one int64, the first as its lowest bit."""
    words = pad(cells, (0, -cells.shape[-1] % CELLS)).unflatten(-1, (-1, CELLS))
    return (words.long() << torch.arange(CELLS, device=cells.device)).sum(-1)


def unpacked(
    rows: Int[Tensor, "*batch height word"], width: int
) -> Int[Tensor, "*batch height width"]:
    """Return the bits of the first `width` cells as 0 and 1, int32."""
    bits = rows[..., None] >> torch.arange(CELLS, device=rows.device) & 1
    return bits.to(torch.int32).flatten(-2)[..., :width]


def beside(rows: Int[Tensor, "*batch height word"]) -> Int[Tensor, "*batch height word"]:
    """Mark the four neighbours of marked cells; bits past CELLS or the width mean nothing."""
    around = rows << 1 | rows >> 1
    if rows.shape[-1] > 1:
        around[..., 1:] |= rows[..., :-1] >> (CELLS - 1) & 1
        around[..., :-1] |= (rows[..., 1:] & 1) << (CELLS - 1)
    around[..., 1:, :] |= rows[..., :-1, :]
    around[..., :-1, :] |= rows[..., 1:, :]
    return around
