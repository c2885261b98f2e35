"""Searches of planners as machine code, for a CPU: from each robot outwards to its first target.

A flood from all targets visits every cell of every map; a robot's nearest target is mostly a few
steps away. The floods of the planners give the same actions on any device; tests compare the two.
"""

from typing import no_type_check  # numba compiles a function as it stands, not in a wrapper

import numpy as np

from marl_clean.world.searches import GOAL, PASSABLE, UNREACHABLE, fill_grid, machine_code

NONE = -1  # no action: no target, or no search


@machine_code
@no_type_check
def nearest_goal(
    grid: np.ndarray,
    stride: int,
    start: int,
    order: np.ndarray,
    steps: np.ndarray,
    begun: np.ndarray,
    queue: np.ndarray,
) -> tuple[int, int, int]:
    """Return the first action to the first goal that a search reaches, its distance and cell.

    Directions are tried in `order` at every cell. `steps` must be -1 everywhere, and is again at
    the end; `start` is no goal.
    """
    head, tail = 0, 1
    queue[0], steps[start] = start, 0
    action, length, goal = NONE, UNREACHABLE, NONE
    while head < tail and goal == NONE:
        cell = queue[head]
        head += 1
        for direction in order:
            beside = cell + (-stride, 1, stride, -1)[direction]
            if steps[beside] >= 0 or not grid[beside] & PASSABLE:
                continue
            steps[beside] = steps[cell] + 1
            begun[beside] = direction if cell == start else begun[cell]
            queue[tail] = beside
            tail += 1
            if grid[beside] & GOAL:
                action, length, goal = begun[beside], steps[beside], beside
                break
    for index in range(tail):
        steps[queue[index]] = -1
    return action, length, goal


@machine_code
@no_type_check
def first_actions(
    passable: np.ndarray,
    goals: np.ndarray,
    starts: np.ndarray,
    rank: np.ndarray,
    waiting: np.ndarray,
    greedy: bool,
) -> np.ndarray:
    """Return the first action of each `waiting` robot to its nearest goal, NONE without one.

    `passable` and `goals` are [env, map, row, col], one map for all robots or one for each, goals
    passable; `starts` flat cells [env, robot]; `rank` [env, robot, 4]. `greedy`: of all pairs of a
    robot and a goal the closest is taken first (ties: the lower robot), and its goal is no other
    robot's; who is left without a goal goes for its own nearest.
    """
    envs, robots = starts.shape
    maps, rows, cols = passable.shape[1:]
    stride = cols + 2
    result = np.full((envs, robots), NONE, np.int64)
    grids = np.zeros((maps, (rows + 2) * stride), np.uint8)
    steps = np.full((rows + 2) * stride, -1, np.int32)
    begun = np.empty((rows + 2) * stride, np.int8)
    queue = np.empty(rows * cols, np.int32)
    orders = np.empty((robots, 4), np.int64)
    cells, goal = np.empty(robots, np.int64), np.empty(robots, np.int64)
    length, action = np.empty(robots, np.int64), np.empty(robots, np.int64)
    for env in range(envs):
        length[:] = UNREACHABLE
        for robot in range(robots):
            own = robot if maps > 1 else 0
            if not waiting[env, robot]:
                continue
            orders[robot] = np.argsort(rank[env, robot])
            cell = starts[env, robot]
            cells[robot] = (cell // cols + 1) * stride + cell % cols + 1
            if maps > 1 or not waiting[env, :robot].any():
                fill_grid(grids[own], stride, passable[env, own], goals[env, own])
            action[robot], length[robot], goal[robot] = nearest_goal(
                grids[own], stride, cells[robot], orders[robot], steps, begun, queue
            )
            result[env, robot] = action[robot]
        for _ in range(robots if greedy else 0):
            chosen = np.argmin(length)
            if length[chosen] == UNREACHABLE:
                break
            result[env, chosen], length[chosen] = action[chosen], UNREACHABLE
            struck = goal[chosen]
            for own in range(maps):
                grids[own, struck] &= PASSABLE
            for robot in range(robots):
                if length[robot] < UNREACHABLE and goal[robot] == struck:
                    own = robot if maps > 1 else 0
                    action[robot], length[robot], goal[robot] = nearest_goal(
                        grids[own], stride, cells[robot], orders[robot], steps, begun, queue
                    )
    return result
