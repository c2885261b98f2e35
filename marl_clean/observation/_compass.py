"""The compass as machine code, for a CPU: one pass over the worlds without intermediate tensors.

The tensor code of `compass` gives the same numbers on any device; tests compare the two.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np

from marl_clean.world.searches import (
    GOAL,
    PASSABLE,
    UNREACHABLE,
    first_steps_of_robot,
    machine_code,
    spread_distances,
)

BLOCKS = 5  # the side of a grid of blocks
BLOCK_CELLS = (3, 9)  # the sides of blocks in cells, one grid each
BLOCK_PLANES = 4
PLANES = 5
FRESH_STEPS = 12.0  # time constant of the exponential decay of cleanness
NEARER_CELLS = 3  # the plane of distances is clipped here
FAR_CELLS = 10  # the offset of another robot is clipped here
FARTHEST = 1023  # walking distances are clipped here
FURTHER = 3 * 4 + 1 + 4 + 2 * 5  # numbers after planes and blocks


class Known(NamedTuple):
    """One map in the form of the searches: flat, `stride` cells a row, a ring of zeros around."""

    stride: int
    goals: np.ndarray  # grid whose goals are unknown cells and those not cleaned yet
    unknown: np.ndarray  # grid whose goals are unknown cells
    onward: np.ndarray  # grid whose goals are unknown cells that do not just continue a known wall
    steps: np.ndarray  # from the nearest of `goals`
    sums: np.ndarray  # [2, row, col]: unknown and blocked cells above and left
    reached: np.ndarray  # buffers of the searches
    begun: np.ndarray
    queue: np.ndarray


@machine_code
@no_type_check
def fill(
    out: np.ndarray,
    record: np.ndarray,
    margin: int,
    rows: np.ndarray,
    cols: np.ndarray,
    now: np.ndarray,
    position: np.ndarray,
    centre: np.ndarray,
    visible: np.ndarray,
    view_size: int,
) -> None:
    """Fill `out` [env, robot, number] in the order of the docstring of `Compass`.

    `record` is [env, map, height, width] with its margin; `rows`, `cols` and `now` are [env];
    `position` and `centre` [env, robot, 2], places in the house; `visible` [env, robot, robot].
    """
    envs, robots = position.shape[:2]
    maps = record.shape[1]
    height, width = record.shape[2] - 2 * margin + 2, record.shape[3] - 2 * margin + 2
    known = blank(height, width)
    others = np.empty(robots, np.int32)
    no_rivals = np.zeros(robots, np.bool_)
    for env in range(envs):
        size = rows[env], cols[env]
        for robot in range(robots):
            others[robot] = cell_of(known, position[env, robot])
        for robot in range(robots):
            held = record[env, robot if maps > 1 else 0]
            if robot < maps:
                read_map(known, held, margin, size)
            here, place = out[env, robot], centre[env, robot]
            write_square(here, known, held, margin, size, now[env], place, view_size)
            at = PLANES * view_size**2
            for block in BLOCK_CELLS:
                write_blocks(here[at : at + BLOCK_PLANES * BLOCKS**2], known.sums, place, block)
                at += BLOCK_PLANES * BLOCKS**2
            start, sees = cell_of(known, place), visible[env, robot]
            write_neighbours(here, at, known, start, view_size)
            write_others(here, at + 13, position[env], place, sees, view_size)
            write_first_steps(here[at + 17 :], known, known.unknown, start, others, sees)
            write_first_steps(here[at + 22 :], known, known.onward, start, others, no_rivals)


@machine_code
@no_type_check
def blank(height: int, width: int) -> Known:
    """Return empty buffers for a house and its ring of `height` x `width` cells."""
    cells = (height + 2) * (width + 2)
    return Known(
        stride=width + 2,
        goals=np.zeros(cells, np.uint8),
        unknown=np.zeros(cells, np.uint8),
        onward=np.zeros(cells, np.uint8),
        steps=np.empty(cells, np.int32),
        sums=np.zeros((2, height + 1, width + 1), np.int32),
        reached=np.full(cells, -1, np.int32),
        begun=np.zeros(cells, np.uint8),
        queue=np.empty(height * width, np.int32),
    )


@machine_code
@no_type_check
def cell_of(known: Known, place: np.ndarray) -> int:
    """Return the index of a place of the house in the flat map."""
    return (place[0] + 2) * known.stride + place[1] + 2


@machine_code
@no_type_check
def read_map(known: Known, held: np.ndarray, margin: int, size: tuple[int, int]) -> None:
    """Read a map [height, width] with its margin into `known`, and search it."""
    height, width = known.sums.shape[1] - 1, known.sums.shape[2] - 1
    for row in range(height):
        cell = (row + 1) * known.stride + 1
        unknown = blocked = 0
        for col in range(width):
            value = held[row + margin - 1, col + margin - 1]
            passable = PASSABLE if value > 0 else 0
            is_unknown = value == 0 and row < size[0] + 2 and col < size[1] + 2
            is_uncleaned = value > 0 and value != math.floor(value)
            # Nobody has to visit the ring, which is unknown all the same.
            is_goal = is_unknown and 0 < row <= size[0] and 0 < col <= size[1]
            known.unknown[cell] = passable | (GOAL if is_goal else 0)
            known.goals[cell] = known.unknown[cell] | (GOAL if is_uncleaned else 0)
            onward = is_goal and not continues_wall(held, margin, row, col)
            known.onward[cell] = passable | (GOAL if onward else 0)
            unknown += is_unknown
            blocked += value < 0
            known.sums[0, row + 1, col + 1] = known.sums[0, row, col + 1] + unknown
            known.sums[1, row + 1, col + 1] = known.sums[1, row, col + 1] + blocked
            cell += 1
    spread_distances(known.goals, known.stride, known.steps, known.queue)


@machine_code
@no_type_check
def continues_wall(held: np.ndarray, margin: int, row: int, col: int) -> bool:
    """Whether a cell of the house and its ring lies in line with two known walls."""
    for down, right in ((1, 0), (0, 1)):
        before = is_wall(held, margin, row - down, col - right)
        after = is_wall(held, margin, row + down, col + right)
        if before and (after or is_wall(held, margin, row - 2 * down, col - 2 * right)):
            return True
        if after and is_wall(held, margin, row + 2 * down, col + 2 * right):
            return True
    return False


@machine_code
@no_type_check
def is_wall(held: np.ndarray, margin: int, row: int, col: int) -> bool:
    """Whether a cell of the house and its ring is known to be blocked; false outside of these."""
    height, width = held.shape[0] - 2 * margin + 2, held.shape[1] - 2 * margin + 2
    if not (0 <= row < height and 0 <= col < width):
        return False
    return held[row + margin - 1, col + margin - 1] < 0


@machine_code
@no_type_check
def write_square(
    here: np.ndarray,
    known: Known,
    held: np.ndarray,
    margin: int,
    size: tuple[int, int],
    now: float,
    place: np.ndarray,
    view_size: int,
) -> None:
    """Write blocked, unknown, cleanness and nearer cells of the square around a robot."""
    half, square = view_size // 2, view_size**2
    height, width = known.sums.shape[1] - 1, known.sums.shape[2] - 1
    own = known.steps[cell_of(known, place)]
    at = 0
    for row in range(place[0] - half, place[0] + half + 1):
        for col in range(place[1] - half, place[1] + half + 1):
            value = held[row + margin, col + margin]
            inside = -1 <= row <= size[0] and -1 <= col <= size[1]
            cleanness = 0.0
            if value > 0:
                is_cleaned = value == math.floor(value)
                cleanness = 0.3 + 0.7 * math.exp((value - now) / FRESH_STEPS) if is_cleaned else -1
            nearer = -NEARER_CELLS
            if own == UNREACHABLE:
                nearer = 0
            elif -1 <= row < height - 1 and -1 <= col < width - 1:
                nearer = own - known.steps[(row + 2) * known.stride + col + 2]
            here[at] = value < 0
            here[square + at] = value == 0 and inside
            here[2 * square + at] = cleanness
            here[3 * square + at] = min(max(nearer, -NEARER_CELLS), NEARER_CELLS) / NEARER_CELLS
            here[4 * square + at] = 0  # other robots are marked later
            at += 1


@machine_code
@no_type_check
def write_blocks(here: np.ndarray, sums: np.ndarray, place: np.ndarray, block: int) -> None:
    """Write the shares of unknown and blocked cells in a grid of blocks, and any unknown."""
    height, width = sums.shape[1] - 1, sums.shape[2] - 1
    first = BLOCKS * block // 2
    for index in range(BLOCKS**2):
        top = place[0] + 1 - first + index // BLOCKS * block
        left = place[1] + 1 - first + index % BLOCKS * block
        bottom, right = min(max(top + block, 0), height), min(max(left + block, 0), width)
        top, left = min(max(top, 0), height), min(max(left, 0), width)
        for kind in range(2):
            total = sums[kind, bottom, right] - sums[kind, top, right]
            total += sums[kind, top, left] - sums[kind, bottom, left]
            here[kind * BLOCKS**2 + index] = total / block**2
        here[2 * BLOCKS**2 + index] = here[index] > 0
        here[3 * BLOCKS**2 + index] = 0  # other robots are marked later


@machine_code
@no_type_check
def write_neighbours(here: np.ndarray, at: int, known: Known, start: int, view_size: int) -> None:
    """Write which actions lead nearer, into the unknown and into walls; and a goal's distance."""
    half, square = view_size // 2, view_size**2
    middle = half * view_size + half
    around = (middle - view_size, middle + 1, middle + view_size, middle - 1)
    sides = (-known.stride, 1, known.stride, -1)
    for action in range(4):
        here[at + action] = known.steps[start + sides[action]] < known.steps[start]
        here[at + 4 + action] = here[square + around[action]]
        here[at + 8 + action] = here[around[action]]
    here[at + 12] = log_distance(known.steps[start])


@machine_code
@no_type_check
def write_others(
    here: np.ndarray,
    at: int,
    position: np.ndarray,
    place: np.ndarray,
    visible: np.ndarray,
    view_size: int,
) -> None:
    """Mark the visible robots in the square and the blocks, and write where the nearest is."""
    half = view_size // 2
    here[at : at + 4] = 0
    nearest = (np.inf, 0, 0)
    for other in range(len(visible)):
        if not visible[other]:
            continue
        row, col = position[other, 0] - place[0], position[other, 1] - place[1]
        if abs(row) <= half and abs(col) <= half:
            here[4 * view_size**2 + (row + half) * view_size + col + half] = 1
        plane = PLANES * view_size**2 + 3 * BLOCKS**2
        for block in BLOCK_CELLS:
            first = BLOCKS * block // 2
            block_row, block_col = (row + first) // block, (col + first) // block
            if 0 <= block_row < BLOCKS and 0 <= block_col < BLOCKS:
                here[plane + block_row * BLOCKS + block_col] = 1
            plane += BLOCK_PLANES * BLOCKS**2
        if (row * row + col * col, row, col) < nearest:
            nearest = (float(row * row + col * col), row, col)
            here[at] = min(max(row / FAR_CELLS, -1), 1)
            here[at + 1] = min(max(col / FAR_CELLS, -1), 1)
            here[at + 2] = 1
            here[at + 3] = 1 / (1 + math.sqrt(row * row + col * col))


@machine_code
@no_type_check
def write_first_steps(
    here: np.ndarray,
    known: Known,
    goals: np.ndarray,
    start: int,
    others: np.ndarray,
    rivals: np.ndarray,
) -> None:
    """Write which actions lead to the nearest goal that is nearer to no rival; its distance."""
    bits, length = first_steps_of_robot(
        goals, known.stride, start, others, rivals, known.reached, known.begun, known.queue
    )
    for action in range(4):
        here[action] = (bits >> action) & 1
    here[4] = log_distance(length)


@machine_code
@no_type_check
def log_distance(steps: int) -> float:
    """Return log2(1 + d) / 10 of a walking distance, at most 1."""
    return math.log2(1.0 + min(steps, FARTHEST)) / 10
