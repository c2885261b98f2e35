"""Generated houses: bounds, connection, doors, furniture, determinism, and how much is free."""

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.open import Open
from marl_clean.house.rooms import FREE, WALL, Box, Rooms, _fits

ROOT = Path(__file__).parents[2]
SEEDS = st.integers(0, 3_000_000)
WITHOUT_FURNITURE = [10_000, 10_000]
RANGES = st.tuples(st.integers(3, 16), st.integers(0, 5)).map(lambda pair: [pair[0], sum(pair)])


SMALL = st.integers(1, 4)
ORDERED = st.tuples(SMALL, SMALL).map(sorted)
LAYOUTS = st.fixed_dictionaries(
    {
        "rows": RANGES,
        "cols": RANGES,
        "smallest_room": SMALL,
        "largest_room": st.integers(1, 60),
        "divide": st.floats(0, 1),
        "doors": ORDERED,
        "cells_per_piece": st.tuples(SMALL, st.integers(1, 20)).map(sorted),
        "piece_sides": ORDERED,
        "against_wall": st.floats(0, 1),
    }
)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(LAYOUTS, SEEDS)
def test_any_house_is_walled_connected_and_furnished_with_rectangles(
    layout: dict[str, Any], seed: int
) -> None:
    house = Rooms(**layout)
    plan = house.layout(seed)
    rows, cols = plan.free.shape
    assert house.rows[0] <= rows <= house.rows[1] and house.cols[0] <= cols <= house.cols[1]
    assert plan.free.dtype == bool and plan.furniture.dtype == np.int16
    assert plan.source == seed and plan.starts is None
    edge = np.ones_like(plan.free)
    edge[1:-1, 1:-1] = False
    assert not plan.free[edge].any() and not plan.furniture[edge].any()
    assert ndimage.label(plan.free)[1] == 1
    assert not (plan.free & (plan.furniture > 0)).any()
    boxes = ndimage.find_objects(plan.furniture)
    for number, box in enumerate(boxes, start=1):
        assert (plan.furniture[box] == number).all()
        assert max(plan.furniture[box].shape) <= house.piece_sides[1]


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(LAYOUTS, SEEDS)
def test_rooms_are_rectangles_joined_by_doors_one_cell_wide(
    layout: dict[str, Any], seed: int
) -> None:
    layout["smallest_room"] = max(layout["smallest_room"], 2)
    bare = Rooms(**(layout | {"cells_per_piece": WITHOUT_FURNITURE}))
    free = np.pad(bare.layout(seed).free, 1)
    if min(free.shape) - 4 < bare.smallest_room:
        return  # one corridor, all of which looks like doors
    # A door has walls on two opposite sides and floor on the other two; no cell of a room does.
    up, down, left, right = free[:-2, 1:-1], free[2:, 1:-1], free[1:-1, :-2], free[1:-1, 2:]
    doors = free[1:-1, 1:-1] & ((up & down & ~left & ~right) | (~up & ~down & left & right))
    rooms, count = ndimage.label(free[1:-1, 1:-1] & ~doors)
    for number, box in enumerate(ndimage.find_objects(rooms), start=1):
        assert (rooms[box] == number).all()
        assert min(rooms[box].shape) >= bare.smallest_room
    for row, col in np.argwhere(doors):
        around = {int(rooms[row + 1, col]), int(rooms[row - 1, col])}
        across = {int(rooms[row, col + 1]), int(rooms[row, col - 1])}
        assert sorted(map(len, (around - {0}, across - {0}))) == [0, 2]
    assert count - 1 <= doors.sum() <= (count - 1) * bare.doors[1]


@pytest.mark.parametrize("rows, cols", [(3, 7), (7, 3), (3, 3), (3, 40), (40, 3), (4, 4)])
def test_odd_shapes(rows: int, cols: int) -> None:
    drawn = draw_houses(Rooms([rows, rows], [cols, cols]), range(30), n_agents=0)
    assert drawn.free.shape == (30, rows, cols)
    assert (drawn.free_cells >= 1).all()


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(LAYOUTS, SEEDS)
def test_a_house_is_a_function_of_seed_and_draw(layout: dict[str, Any], seed: int) -> None:
    house = Rooms(**layout)
    first, again = house.layout(seed), house.layout(seed)
    np.testing.assert_array_equal(first.free, again.free)
    np.testing.assert_array_equal(first.furniture, again.furniture)


def test_other_seeds_and_other_draws_are_other_houses() -> None:
    house = Rooms([14, 14], [14, 14])
    plans = [house.layout(seed, draw).free.tobytes() for seed in range(20) for draw in range(5)]
    assert len(set(plans)) == 100


def test_furniture_settings_leave_the_walls_where_they_are() -> None:
    furnished, bare = (
        Rooms([14, 14], [14, 14]),
        Rooms([14, 14], [14, 14], cells_per_piece=WITHOUT_FURNITURE),
    )
    for seed in range(50):
        plan = furnished.layout(seed)
        np.testing.assert_array_equal(plan.free | (plan.furniture > 0), bare.layout(seed).free)


def test_seed_0_is_this_house_for_good() -> None:
    plan = Rooms([8, 8], [11, 11]).layout(0)
    drawn = ["".join(".#"[not cell] for cell in row) for row in plan.free]
    assert drawn == SEED_0


@pytest.mark.slow
@pytest.mark.parametrize("side, low, high", [(10, 0.74, 0.79), (14, 0.70, 0.75)])
def test_about_three_quarters_of_the_interior_are_free(side: int, low: float, high: float) -> None:
    drawn = draw_houses(Rooms([side, side], [side, side]), range(500), n_agents=2)
    assert low < drawn.free_cells.mean() / (side - 2) ** 2 < high


def test_a_piece_may_not_part_the_floor() -> None:
    grid = [[WALL] * 7, *([WALL, *[FREE] * 5, WALL] for _ in range(3)), [WALL] * 7]
    assert _fits(grid, Box(1, 3, 3, 4))  # a way remains below
    assert not _fits(grid, Box(1, 3, 4, 4))  # from wall to wall
    grid[3][3] = 1
    assert not _fits(grid, Box(1, 3, 3, 4))  # from wall to the first piece
    assert not _fits(grid, Box(3, 3, 4, 4))  # on the first piece
    assert not _fits([[WALL] * 3, [WALL, FREE, WALL], [WALL] * 3], Box(1, 1, 2, 2))  # the last


@pytest.mark.parametrize(
    "settings_, key",
    [
        ({"rows": [2, 5]}, "house.rows"),
        ({"cols": [9, 8]}, "house.cols"),
        ({"doors": [0, 1]}, "house.doors"),
        ({"cells_per_piece": [3]}, "house.cells_per_piece"),
        ({"piece_sides": [2, 1]}, "house.piece_sides"),
    ],
)
def test_ranges_that_are_none_are_named(settings_: dict, key: str) -> None:
    with pytest.raises(BadInput, match=f"^{key}: "):
        Rooms(**{"rows": [10, 10], "cols": [10, 10], **settings_})


def test_an_open_floor_is_all_free() -> None:
    plan = Open([1, 1], [5, 5]).layout(3)
    assert plan.free.all() and plan.free.shape == (1, 5) and not plan.furniture.any()
    sizes = {Open([3, 4], [7, 9]).layout(seed).free.shape for seed in range(100)}
    assert sizes == {(rows, cols) for rows in (3, 4) for cols in (7, 8, 9)}
    with pytest.raises(BadInput, match="house.rows"):
        Open([0, 3], [3, 3])


def test_defaults_in_code_are_those_in_the_yaml() -> None:
    written = yaml.safe_load((ROOT / "conf/house/rooms.yaml").read_text())
    assert written.pop("_target_") == "marl_clean.house.rooms.Rooms"
    assert set(written) == set(inspect.signature(Rooms).parameters)
    assert Rooms(**written) == Rooms([10, 10], [10, 10])


SEED_0 = [
    "###########",
    "#.##......#",
    "#.##.#....#",
    "#....#.##.#",
    "#....#.##.#",
    "###.......#",
    "#....#..###",
    "###########",
]
