"""Searches by machine code and by floods of tensors agree with a plain search."""

from collections import deque

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torch import Tensor

from marl_clean.world.distance import (
    UNREACHABLE,
    first_steps,
    is_connected,
    walking_distance,
    within_steps,
)
from marl_clean.world.floods import CELLS, flood, flood_first_steps, flood_within
from tests.reference import Place, neighbour, neighbours

SIDES = st.integers(1, 7)


def plain_distance(passable: Tensor, begin: set[Place], enterable: Tensor) -> dict[Place, int]:
    """Steps from places to others: onto what is enterable, on over what is passable."""
    rows, cols = passable.shape
    steps, queue = dict.fromkeys(begin, 0), deque(begin)
    while queue:
        place = queue.popleft()
        if steps[place] and not passable[place]:
            continue
        for row, col in neighbours(place):
            inside = 0 <= row < rows and 0 <= col < cols
            if inside and enterable[row, col] and (row, col) not in steps:
                steps[row, col] = steps[place] + 1
                queue.append((row, col))
    return steps


def places(mask: Tensor) -> set[Place]:
    return {(row, col) for row, col in mask.nonzero().tolist()}


@pytest.mark.slow
@given(rows=SIDES, cols=SIDES, seed=st.integers(0, 10**6))
@hypothesis_settings(max_examples=60, deadline=None)
def test_walking_distances(rows: int, cols: int, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    passable = torch.rand((3, rows, cols), generator=generator) > 0.3
    sources = torch.rand((3, rows, cols), generator=generator) > 0.8
    steps = walking_distance(passable, sources)
    assert steps.dtype == torch.int32
    assert torch.equal(steps, flood(passable, sources))
    for most in (0, 2, 40):
        assert torch.equal(within_steps(passable, sources, most), steps <= most)
        assert torch.equal(flood_within(passable, sources, most), steps <= most)
    for grid in range(3):
        plain = plain_distance(passable[grid], places(sources[grid]), passable[grid])
        # A source is left even where it is not passable.
        for row in range(rows):
            for col in range(cols):
                assert int(steps[grid, row, col]) == plain.get((row, col), UNREACHABLE)


@pytest.mark.parametrize("cols", [CELLS - 1, CELLS, CELLS + 1, 2 * CELLS + 3])
def test_floods_of_rows_of_more_than_one_word(cols: int) -> None:
    generator = torch.Generator().manual_seed(cols)
    passable = torch.rand((2, 2, 6, cols), generator=generator) > 0.15
    goals = torch.rand(passable.shape, generator=generator) > 0.99
    assert torch.equal(walking_distance(passable, goals), flood(passable, goals))
    start, others = torch.randint(0, 6 * cols, (2, 2, 2), generator=generator)
    rivals = torch.tensor([[[False, True], [True, False]], [[False, False], [False, False]]])
    searched = first_steps(passable, goals, start, others, rivals)
    assert (searched[1] < UNREACHABLE).any()
    for fast, plain in zip(
        searched, flood_first_steps(passable, goals, start, others, rivals), strict=True
    ):
        assert torch.equal(fast, plain)


@pytest.mark.slow
@given(
    rows=SIDES, cols=SIDES, robots=st.integers(1, 4), maps=st.booleans(), seed=st.integers(0, 10**6)
)
@hypothesis_settings(max_examples=80, deadline=None)
def test_first_steps(rows: int, cols: int, robots: int, maps: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    shape = (2, robots if maps else 1, rows, cols)
    passable = torch.rand(shape, generator=generator) > 0.3
    goals = torch.rand(shape, generator=generator) > 0.7
    start, others = torch.randint(0, rows * cols, (2, 2, robots), generator=generator)
    rivals = torch.rand((2, robots, robots), generator=generator) > 0.4
    rivals &= ~torch.eye(robots, dtype=torch.bool)
    ways, lengths = first_steps(passable, goals, start, others, rivals)
    for fast, plain in zip(
        (ways, lengths), flood_first_steps(passable, goals, start, others, rivals), strict=True
    ):
        assert torch.equal(fast, plain)
    for env in range(2):
        for robot in range(robots):
            which = robot if maps else 0
            floor, aims = passable[env, which], goals[env, which]
            begin = divmod(int(start[env, robot]), cols)
            of_rivals = [
                divmod(int(others[env, other]), cols)
                for other in range(robots)
                if rivals[env, robot, other]
            ]
            expected, length = plain_first_steps(floor, aims, begin, of_rivals)
            assert ways[env, robot].tolist() == expected
            assert int(lengths[env, robot]) == length


def plain_first_steps(
    passable: Tensor, goals: Tensor, begin: Place, rivals: list[Place]
) -> tuple[list[bool], int]:
    enterable, rows, cols = passable | goals, *passable.shape
    own = plain_distance(passable, {begin}, enterable)
    of_rivals = [plain_distance(passable, {rival}, enterable) for rival in rivals]
    left = [
        goal
        for goal in places(goals)
        if own.get(goal, 0) and all(own[goal] <= walk.get(goal, own[goal]) for walk in of_rivals)
    ]
    if not left:
        return [False] * 4, UNREACHABLE
    length = min(own[goal] for goal in left)
    ways = []
    for action in range(4):
        row, col = neighbour(begin, action)
        leads = False
        if 0 <= row < rows and 0 <= col < cols and enterable[row, col]:
            is_open = passable.clone()
            is_open[begin] = False
            walk = {(row, col): 0}
            if is_open[row, col]:
                walk = plain_distance(is_open, {(row, col)}, enterable)
            leads = any(walk.get(goal) == length - 1 for goal in left if own[goal] == length)
        ways.append(leads)
    return ways, length


@pytest.mark.slow
def test_a_map_of_rows_cut_out_of_a_larger_one() -> None:
    """Slices are read where they lie, not as if they were whole."""
    large = torch.ones((2, 6, 7), dtype=torch.bool)
    large[:, 2:4, 3] = False
    sources = torch.zeros_like(large)
    sources[:, 2, 2] = True
    cut = slice(1, 5), slice(1, 6)
    steps = walking_distance(large[:, *cut], sources[:, *cut])
    assert torch.equal(steps, flood(large[:, *cut], sources[:, *cut]))
    assert int(steps[0, 1, 3]) == 4  # around the wall


def test_connected() -> None:
    free = torch.tensor([[[1, 0, 1]], [[1, 1, 0]], [[0, 0, 0]]], dtype=torch.bool)
    assert is_connected(free).tolist() == [False, True, True]
