"""The eight symmetries of the square, for what robots see and for what they do.

A house rotated or mirrored is as good a house, so a transition rotated or mirrored is as good a
transition. Element g in 0..7 mirrors left and right if g >= 4, then rotates by g % 4 quarters
counterclockwise.
"""

import torch
from jaxtyping import Bool, Float, Int, Num
from tensordict import TensorDictBase
from torch import Tensor

from marl_clean import keys

NUM_SYMMETRIES = 8
MIRRORED = (0, 3, 2, 1)
"""The action that does in the mirrored house what up, right, down, left do in the first."""


def rotate_square(
    square: Num[Tensor, "*batch row col"], element: int
) -> Num[Tensor, "*batch row col"]:
    """Return squares mirrored and rotated by one element of the group."""
    if element >= 4:
        square = square.flip(-1)
    return torch.rot90(square, element % 4, (-2, -1))


def rotate_action(action: Int[Tensor, "*batch"], element: int) -> Int[Tensor, "*batch"]:
    """Return the actions that do in the rotated squares what these do in the first.

    A quarter counterclockwise makes up of right: (row, col) moves 0 (-1, 0), 1 (0, 1), 2 (1, 0),
    3 (0, -1) become those of (action - quarters) mod 4.
    """
    if element >= 4:
        action = action.new_tensor(MIRRORED)[action]
    return (action - element % 4) % 4


def rotate_offset(offset: Num[Tensor, "*batch 2"], element: int) -> Num[Tensor, "*batch 2"]:
    """Return (row, col) offsets as they are in the rotated squares.

    Mirrored, (row, col) becomes (row, -col); a quarter counterclockwise makes of it (-col, row).
    """
    row, col = offset.unbind(-1)
    if element >= 4:
        col = -col
    for _ in range(element % 4):
        row, col = -col, row
    return torch.stack([row, col], dim=-1)


def rotate_in_eighths(
    squares: list[Float[Tensor, "frame ... row col"]], action: Int[Tensor, "frame ..."]
) -> tuple[list[Float[Tensor, "frame ... row col"]], Int[Tensor, "frame ..."]]:
    """Rotate the k-th eighth of a batch by the k-th element: squares and actions alike.

    For a batch drawn at random, frame by frame, every frame's element is thereby random too,
    at the cost of eight copies and without a draw.
    """
    rotated_squares = [torch.empty_like(square) for square in squares]
    rotated_action = torch.empty_like(action)
    for element, part in enumerate(_eighths(len(action))):
        for square, rotated in zip(squares, rotated_squares, strict=True):
            rotated[part] = rotate_square(square[part], element)
        rotated_action[part] = rotate_action(action[part], element)
    return rotated_squares, rotated_action


def rotate_masks_in_eighths(
    masks: list[Bool[Tensor, "frame ... action"]],
) -> list[Bool[Tensor, "frame ... action"]]:
    """Rotate masks of actions as `rotate_in_eighths` does the actions."""
    rotated_masks = [torch.empty_like(mask) for mask in masks]
    action = torch.arange(len(MIRRORED), device=masks[0].device)
    for element, part in enumerate(_eighths(len(masks[0]))):
        order = rotate_action(action, element)
        for mask, rotated in zip(masks, rotated_masks, strict=True):
            rotated[part, ..., order] = mask[part]
    return rotated_masks


def rotate_frames_(frames: TensorDictBase) -> None:
    """Rotate the eighths of a batch of frames in place: all that has a direction in it."""
    squares = [frames[keys.OBSERVATION], frames["next", keys.OBSERVATION]]
    (now, then), action = rotate_in_eighths(squares, frames[keys.ACTION])
    frames[keys.OBSERVATION], frames["next", keys.OBSERVATION] = now, then
    held = frames.keys(True)
    if keys.ACTION_MASK in held:
        masks = [frames[keys.ACTION_MASK], frames["next", keys.ACTION_MASK]]
        now, then = rotate_masks_in_eighths(masks)
        frames[keys.ACTION_MASK], frames["next", keys.ACTION_MASK] = now, then
    turning = (
        (keys.OFFSET, rotate_offset),
        (keys.KNOWN, rotate_square),
        (keys.MISSING, rotate_square),
    )
    for key, rotate in turning:
        for part in (frames, frames["next"]):
            if (entry := part.get(key)) is not None:
                eighths = enumerate(_eighths(len(entry)))
                part[key] = torch.cat([rotate(entry[k], element) for element, k in eighths])
    if keys.DEMONSTRATION in held:
        planned = frames[keys.DEMONSTRATION]
        _, rotated = rotate_in_eighths([], planned.clamp(min=0))
        frames[keys.DEMONSTRATION] = torch.where(planned >= 0, rotated, -1)
    frames[keys.ACTION] = action


def _eighths(length: int) -> list[slice]:
    bounds = [length * k // NUM_SYMMETRIES for k in range(NUM_SYMMETRIES + 1)]
    return [slice(low, high) for low, high in zip(bounds, bounds[1:], strict=False)]
