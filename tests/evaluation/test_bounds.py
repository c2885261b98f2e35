"""Bounds on hand-made houses, and walks against a plain search."""

from collections import deque
from fractions import Fraction
from math import ceil

import numpy as np
import pytest

from marl_clean.evaluation.bounds import (
    bound_100,
    bound_certify,
    bound_percent,
    count_border,
    need,
    walking_distance,
)


def house_of(picture: str) -> np.ndarray:
    """One house as [1, row, col], `.` free and `#` blocked."""
    return np.array([[[mark == "." for mark in line] for line in picture.split()]])


def plain_walk(free, starts):
    distance = {start: 0 for start in starts}
    queue = deque(starts)
    while queue:
        row, col = queue.popleft()
        for place in ((row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)):
            inside = 0 <= place[0] < free.shape[0] and 0 <= place[1] < free.shape[1]
            if inside and free[place] and place not in distance:
                distance[place] = distance[(row, col)] + 1
                queue.append(place)
    return distance


@pytest.mark.parametrize("percent", [90, 95, 99, 100])
def test_need_is_the_exact_ceiling(percent):
    for num_free in range(1, 1_000):
        assert need(percent, num_free) == ceil(Fraction(percent * num_free, 100))


def test_need_where_floats_and_shortcuts_go_wrong():
    assert [need(90, free) for free in (9, 10, 11, 20, 100)] == [9, 9, 10, 18, 90]
    assert [need(99, free) for free in (99, 100, 101, 200)] == [99, 99, 100, 198]


def test_work_bounds_an_open_house():
    free, starts = house_of("....... ....... ......."), np.array([[[0, 0], [2, 6]]])
    assert bound_100(free, starts) == 10  # 19 cells for two robots
    assert bound_percent(90, np.array([21]), np.array([2]), 2) == 9  # 19 - 2, halved


def test_the_walk_bounds_a_corridor_that_starts_at_one_end():
    free, starts = house_of("......."), np.array([[[0, 0], [0, 1]]])
    assert bound_100(free, starts) == 5


def test_a_house_that_the_starts_fill_is_bounded_by_nothing():
    free, starts = house_of(".."), np.array([[[0, 0], [0, 1]]])
    assert bound_100(free, starts) == 0
    assert bound_percent(90, np.array([2]), np.array([2]), 2) == 0


def test_border_counts_each_blocked_cell_once_and_the_ring_but_no_corner():
    assert count_border(house_of(".")) == 4
    assert count_border(house_of(".#.")) == 1 + 6  # the middle once, and the ring
    free, starts = house_of(".#. ..."), np.array([[[0, 0]]])
    # The wall between, then the ring: two above, one left and right of each row, three below.
    assert count_border(free) == 1 + 2 + 4 + 3
    assert bound_certify(free, starts) == 5 - 1 + 10


@pytest.mark.parametrize("shape", [(3, 7), (7, 3), (1, 9), (12, 5)])
def test_walks_equal_a_plain_search(shape):
    rng = np.random.default_rng(shape[0])
    free = rng.random((6, *shape)) < 0.7
    free[:, 0, 0] = free[:, -1, -1] = True
    starts = np.tile([[[0, 0], [shape[0] - 1, shape[1] - 1]]], (6, 1, 1))
    distance = walking_distance(free, starts)
    for house in range(6):
        plain = plain_walk(free[house], [(0, 0), (shape[0] - 1, shape[1] - 1)])
        for place in np.ndindex(shape):
            assert distance[house][place] == plain.get(place, -1)
