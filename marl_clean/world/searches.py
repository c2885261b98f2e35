"""Breadth-first searches as machine code, for a CPU: a cell is visited once, not at every step.

The floods of `floods` give the same numbers on any device; tests compare the two.
"""

import math
from typing import no_type_check  # numba compiles a function as it stands, not in a wrapper

import numba
import numpy as np

UNREACHABLE = 1 << 30
PASSABLE, GOAL = np.uint8(1), np.uint8(2)  # what a cell of a grid is; 0: impassable
START = np.uint8(16)  # of a wave, beside the four bits of first steps

machine_code = numba.njit(cache=True, nogil=True)


@machine_code
@no_type_check
def spread_distances(grid: np.ndarray, stride: int, steps: np.ndarray, queue: np.ndarray) -> None:
    """Write the steps from the nearest goal to every cell into `steps`, UNREACHABLE elsewhere.

    `grid` is flat, `stride` cells a row, with a ring of zeros around.
    """
    head = tail = 0
    for cell in range(len(grid)):
        steps[cell] = UNREACHABLE
        if grid[cell] & GOAL:
            steps[cell] = 0
            queue[tail] = cell
            tail += 1
    while head < tail:
        cell = queue[head]
        head += 1
        onward = steps[cell] + 1
        for beside in (cell - stride, cell + 1, cell + stride, cell - 1):
            if steps[beside] == UNREACHABLE and grid[beside] & PASSABLE:
                steps[beside] = onward
                queue[tail] = beside
                tail += 1


@machine_code
@no_type_check
def first_steps_of_robot(
    grid: np.ndarray,
    stride: int,
    start: int,
    others: np.ndarray,
    rivals: np.ndarray,
    reached: np.ndarray,
    begun: np.ndarray,
    queue: np.ndarray,
) -> tuple[int, int]:
    """Return a robot's first steps to its nearest goals as four bits, and their distance.

    `grid` is flat, `stride` cells a row, with a ring of zeros around, `start` a cell of it, and
    `others` the cells of all robots, of which the `rivals` send out waves, too. The buffers hold
    the step at which a wave first reached a cell (`reached`), and the robot's first steps that
    lead there (`begun`); they must be -1 and 0 everywhere, and are again at the end.
    """
    head, tail = 0, 1
    queue[0], reached[start], begun[start] = start, 0, START
    for other in range(len(others)):
        cell = others[other]
        if rivals[other] and reached[cell] < 0:
            reached[cell] = 0
            queue[tail] = cell
            tail += 1
    nearest = UNREACHABLE
    while head < tail and reached[queue[head]] < nearest:
        cell = queue[head]
        head += 1
        onward = reached[cell] + 1
        if onward > 1 and not grid[cell] & PASSABLE:
            continue
        for action in range(4):
            beside = cell + (-stride, 1, stride, -1)[action]
            if reached[beside] < 0 and grid[beside]:
                reached[beside] = onward
                queue[tail] = beside
                tail += 1
            if reached[beside] == onward:
                begun[beside] |= 1 << action if begun[cell] == START else begun[cell]
                if grid[beside] & GOAL and begun[beside]:
                    nearest = onward
    bits = 0
    for index in range(tail):
        cell = queue[index]
        if reached[cell] == nearest and grid[cell] & GOAL:
            bits |= begun[cell]
        reached[cell] = -1
        begun[cell] = 0
    return bits, nearest


@machine_code
@no_type_check
def distances(passable: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """Return the steps from the nearest source to every cell of grids [grid, row, col], int32."""
    grids, rows, cols = passable.shape
    stride = cols + 2
    result = np.empty((grids, rows, cols), np.int32)
    grid = np.zeros((rows + 2) * stride, np.uint8)
    steps = np.empty((rows + 2) * stride, np.int32)
    queue = np.empty(rows * cols, np.int32)
    for index in range(grids):
        fill_grid(grid, stride, passable[index], sources[index])
        spread_distances(grid, stride, steps, queue)
        for row in range(rows):
            first = (row + 1) * stride + 1
            result[index, row] = steps[first : first + cols]
    return result


@machine_code
@no_type_check
def steps_to_goals(
    record: np.ndarray,
    margin: int,
    rows: np.ndarray,
    cols: np.ndarray,
    position: np.ndarray,
    farthest: int,
) -> np.ndarray:
    """Return the steps from each robot to the nearest cell that it has to visit, int32.

    `record` is [env, map, height, width] with its margin, one map for all robots or one for each;
    `rows` and `cols` are [env], `position` [env, robot, 2]. UNREACHABLE beyond `farthest` steps.
    """
    envs, robots = position.shape[:2]
    maps, height, width = record.shape[1:]
    result = np.full((envs, robots), UNREACHABLE, np.int32)
    reached = np.full(height * width, -1, np.int32)
    queue = np.empty(height * width, np.int32)
    for env in range(envs):
        for robot in range(robots):
            held = record[env, robot if maps > 1 else 0].reshape(-1)
            head, tail = 0, 1
            row, col = position[env, robot]
            queue[0] = (row + margin) * width + col + margin
            reached[queue[0]] = 0
            while head < tail:
                cell = queue[head]
                head += 1
                value = held[cell]
                row, col = cell // width - margin, cell % width - margin
                inside = 0 <= row < rows[env] and 0 <= col < cols[env]
                if (value == 0 and inside) or (value > 0 and value != math.floor(value)):
                    result[env, robot] = reached[cell]
                    break
                if value <= 0 or reached[cell] == farthest:
                    continue
                for beside in (cell - width, cell + 1, cell + width, cell - 1):
                    if reached[beside] < 0:
                        reached[beside] = reached[cell] + 1
                        queue[tail] = beside
                        tail += 1
            for index in range(tail):
                reached[queue[index]] = -1
    return result


@machine_code
@no_type_check
def first_steps(
    passable: np.ndarray,
    goals: np.ndarray,
    starts: np.ndarray,
    others: np.ndarray,
    rivals: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first steps to each robot's nearest goals, [env, robot, 4], and their distances.

    `passable` and `goals` are [env, map, row, col], one map for all robots or one for each;
    `starts` and `others` are flat cells [env, robot]; `rivals` [env, robot, robot].
    """
    envs, robots = starts.shape
    maps, rows, cols = passable.shape[1:]
    stride = cols + 2
    leads = np.zeros((envs, robots, 4), np.bool_)
    lengths = np.full((envs, robots), UNREACHABLE, np.int32)
    grid = np.zeros((rows + 2) * stride, np.uint8)
    reached = np.full((rows + 2) * stride, -1, np.int32)
    begun = np.zeros((rows + 2) * stride, np.uint8)
    queue = np.empty(rows * cols, np.int32)
    for env in range(envs):
        mates = (others[env] // cols + 1) * stride + others[env] % cols + 1
        for robot in range(robots):
            if robot < maps:
                fill_grid(grid, stride, passable[env, robot], goals[env, robot])
            start = (starts[env, robot] // cols + 1) * stride + starts[env, robot] % cols + 1
            bits, lengths[env, robot] = first_steps_of_robot(
                grid, stride, start, mates, rivals[env, robot], reached, begun, queue
            )
            for action in range(4):
                leads[env, robot, action] = (bits >> action) & 1
    return leads, lengths


@machine_code
@no_type_check
def fill_grid(grid: np.ndarray, stride: int, passable: np.ndarray, goals: np.ndarray) -> None:
    """Write a house into a flat grid with a ring of zeros around."""
    rows, cols = passable.shape
    for row in range(rows):
        cell = (row + 1) * stride + 1
        for col in range(cols):
            grid[cell] = PASSABLE * passable[row, col] | GOAL * goals[row, col]
            cell += 1
