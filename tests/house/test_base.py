"""Splits, stacks, the region rule, and what makes a house unusable."""

import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from marl_clean.errors import BadInput
from marl_clean.house.base import (
    SPLITS,
    House,
    HouseLayout,
    draw_bank,
    draw_houses,
    keep_region,
    split_seeds,
)
from marl_clean.house.open import Open
from marl_clean.house.rooms import Rooms

PLANS = arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7)))


@dataclass(frozen=True)
class Handed(House):
    """A plan that a test hands in, as if it came from a file."""

    generated: ClassVar[bool] = False

    text: str
    starts: tuple[tuple[int, int], ...] | None = None

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        free = np.array([[cell == "." for cell in line] for line in self.text.split()])
        return HouseLayout(free, np.zeros(free.shape, np.int16), self.starts, "handed.txt")


@dataclass(frozen=True)
class Split(House):
    """Two regions at the first two draws of every seed, one from then on."""

    generated: ClassVar[bool] = True

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        free = np.array([[True, draw > 1, True]])
        return HouseLayout(free, np.zeros(free.shape, np.int16), None, seed)


def flooded(free: np.ndarray, start: tuple[int, int]) -> set[tuple[int, int]]:
    """The region of a free cell, one cell at a time."""
    region, border = {start}, [start]
    while border:
        row, col = border.pop()
        for near in ((row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)):
            inside = 0 <= near[0] < free.shape[0] and 0 <= near[1] < free.shape[1]
            if inside and free[near] and near not in region:
                region.add(near)
                border.append(near)
    return region


def cells_of(free: np.ndarray) -> list[tuple[int, int]]:
    return [(int(row), int(col)) for row, col in np.argwhere(free)]


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(PLANS)
def test_without_starts_the_largest_region_stays_the_first_of_equals(free: np.ndarray) -> None:
    plan = HouseLayout(free, np.zeros(free.shape, np.int16), None, "a plan")
    if not free.any():
        with pytest.raises(BadInput, match="a plan: .*no free cell"):
            keep_region(plan)
        return
    regions = [flooded(free, cell) for cell in cells_of(free)]
    expected = min(regions, key=lambda region: (-len(region), min(region)))
    assert set(cells_of(keep_region(plan).free)) == expected


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(PLANS, st.data())
def test_with_starts_their_region_stays_or_they_are_bad(free: np.ndarray, data) -> None:
    if not free.any():
        return
    choice = st.lists(st.sampled_from(cells_of(free)), min_size=1, max_size=3)
    starts = tuple(data.draw(choice))
    plan = HouseLayout(free, np.zeros(free.shape, np.int16), starts, "a plan")
    region = flooded(free, starts[0])
    if region.issuperset(starts):
        assert set(cells_of(keep_region(plan).free)) == region
    else:
        with pytest.raises(BadInput, match="two regions"):
            keep_region(plan)


def test_a_stack_is_padded_with_blocked_cells() -> None:
    house = Rooms([3, 9], [7, 12])
    houses = draw_houses(house, range(50), n_agents=2)
    assert houses.free.shape == houses.furniture.shape
    assert houses.free.shape == (50, houses.rows.max(), houses.cols.max())
    assert houses.rows.min() < houses.rows.max() and houses.cols.min() < houses.cols.max()
    assert houses.sources == list(range(50)) and houses.starts is None and len(houses) == 50
    assert (houses.free_cells > 2).all()
    for index in range(50):
        rows, cols = houses.rows[index], houses.cols[index]
        assert houses.free_cells[index] == houses.free[index, :rows, :cols].sum()
        assert not (houses.free[index] & (houses.furniture[index] > 0)).any()


def test_a_house_does_not_depend_on_its_neighbours_in_the_stack() -> None:
    house = Rooms([5, 9], [5, 9])
    together = draw_houses(house, [7, 8, 9], n_agents=2)
    alone = draw_houses(house, [8], n_agents=2)
    rows, cols = alone.free.shape[1:]
    np.testing.assert_array_equal(together.free[1, :rows, :cols], alone.free[0])


def test_generated_houses_are_drawn_again_until_they_serve() -> None:
    assert draw_houses(Split(), [0, 1], n_agents=2).free_cells.tolist() == [3, 3]
    sizes = draw_houses(Open([1, 2], [1, 3]), range(60), n_agents=4).free_cells
    assert set(sizes.tolist()) == {6}


@pytest.mark.parametrize("rows, cols, n_agents", [(1, 1, 1), (1, 1, 2), (2, 3, 6), (1, 4, 9)])
def test_an_open_house_too_small_is_bad(rows: int, cols: int, n_agents: int) -> None:
    with pytest.raises(BadInput, match=f"more than {n_agents} free cells"):
        draw_houses(Open([rows, rows], [cols, cols]), [0], n_agents)


def test_a_loaded_plan_is_one_house_whatever_the_seeds() -> None:
    houses = draw_houses(Handed("..#...\n#.#..."), [4, 5, 6], n_agents=2)
    assert len(houses) == 1 and houses.sources == ["handed.txt"]
    assert houses.free_cells.tolist() == [6] and houses.starts is None


def test_starts_stay_in_order_the_first_of_them() -> None:
    house = Handed("....", starts=((0, 3), (0, 0), (0, 1)))
    assert draw_houses(house, [0], n_agents=2).starts.tolist() == [[[0, 3], [0, 0]]]
    house = Handed("......", starts=((0, 3),))
    assert draw_houses(house, [0], n_agents=2).starts.tolist() == [[[0, 3]]]


@pytest.mark.parametrize(
    "n_agents, reason", [(3, "clean at step 0"), (4, "more robots than cells")]
)
def test_a_loaded_plan_without_work_is_bad(n_agents: int, reason: str) -> None:
    with pytest.raises(BadInput, match=f"handed.txt: {reason}, free cells: 3, .*: 1 to 2"):
        draw_houses(Handed("...#.."), [0], n_agents)


def test_a_loaded_plan_of_one_cell_serves_nobody() -> None:
    with pytest.raises(BadInput, match="take another floor plan"):
        draw_houses(Handed("#.#"), [0], n_agents=1)


@pytest.mark.slow
def test_a_bank_has_as_many_distinct_houses_as_asked_for() -> None:
    bank = draw_bank(Rooms([10, 10], [10, 10]), 4096, n_agents=2)
    assert len({free.tobytes() for free in bank.free}) == len(bank) == 4096
    assert len(set(bank.sources)) == 4096 and set(bank.sources) <= set(SPLITS["train"])


def test_a_bank_ends_where_there_are_no_more_houses() -> None:
    bank = draw_bank(Open([3, 4], [7, 7]), 50, n_agents=2)
    assert sorted(bank.rows.tolist()) == [3, 4]
    assert len(draw_bank(Handed("......"), 50, n_agents=2)) == 1


def test_splits_do_not_overlap_and_bad_ones_are_named() -> None:
    assert split_seeds("test", 200) == range(2_000_000, 2_000_200)
    assert not set(SPLITS["train"]) & set(SPLITS["validation"])
    assert not set(SPLITS["validation"]) & set(SPLITS["test"])
    with pytest.raises(BadInput, match="train, validation, test"):
        split_seeds("tests", 3)
    with pytest.raises(BadInput, match="1 to 10000"):
        split_seeds("test", 10_001)
    with pytest.raises(BadInput, match="no seeds"):
        draw_houses(Open([3, 3], [3, 3]), [], n_agents=1)


@pytest.mark.slow
def test_the_room_does_without_torch() -> None:
    modules = ", ".join(f"marl_clean.house.{name}" for name in ("rooms", "open", "floorplan"))
    code = f"import sys, marl_clean.house.drawn, {modules}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
