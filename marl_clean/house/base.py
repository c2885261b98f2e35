"""Houses: the layout of one, the class that draws layouts, and stacks of many.

Rules: world.md "Grid, robots, time". NumPy only, so that the commands can check a house before
torch is imported.
"""

import random
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy import ndimage

from marl_clean.errors import BadInput
from marl_clean.house._regions import Regions, split_regions

# Seeds of houses to train on, to choose weights on, and to measure once.
SPLITS: dict[str, range] = {
    "train": range(0, 1_000_000),
    "validation": range(1_000_000, 1_010_000),
    "test": range(2_000_000, 2_010_000),
}
DRAWS_PER_SEED = 100


@dataclass(frozen=True)
class HouseLayout:
    """One house: its free cells, its furniture, and the cells in which robots start.

    `free` is bool [rows, cols]; `furniture` int16 [rows, cols]: 0 none, k > 0 piece k. `starts`
    are the cells a file gives, in the robots' order; `source` is the seed or the path. Floor plans
    alone have `unknown`, bool [rows, cols], blocked cells of which nothing is known, and, where the
    file has a scale, `cell_metres`, the side of a cell.
    """

    free: np.ndarray
    furniture: np.ndarray
    starts: tuple[tuple[int, int], ...] | None
    source: int | str
    unknown: np.ndarray | None = None
    cell_metres: float | None = None

    def regions(self) -> Regions:
        """The region that is the house, see `split_regions`, and those that are left out."""
        return split_regions(self.free, self.starts, self.source)


class House(ABC):
    """Draws house layouts. A level of the room is one subclass, final."""

    generated: ClassVar[bool]  # True: a layout for every seed; False: one floor plan, from a file
    shares_count: ClassVar[bool] = False  # True: how many seeds give a layout matters

    @abstractmethod
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        """The layout of a seed, and of nothing else; `draw` counts the redraws of that seed.

        A floor plan ignores both. Raises BadInput where the file cannot be used.
        """

    def parts(self) -> Sequence["House"]:
        """The houses that layouts are drawn from: itself, unless it is a mixture."""
        return [self]


@dataclass(frozen=True)
class Houses:
    """N houses as one stack, padded with blocked cells to the largest.

    `free` bool [N, R, C]; `furniture` int16 [N, R, C]; `rows` and `cols` int64 [N], each house's
    own; `starts` int64 [N, k, 2] as (row, col), k <= n_agents, -1 where a house gives fewer, or
    None where the world draws all; `sources` the seeds or paths.
    """

    free: np.ndarray
    furniture: np.ndarray
    rows: np.ndarray
    cols: np.ndarray
    starts: np.ndarray | None
    sources: list[int | str]

    def __len__(self) -> int:
        return len(self.sources)

    @property
    def free_cells(self) -> np.ndarray:
        """Free cells of each house, int64 [N]."""
        return np.count_nonzero(self.free, axis=(1, 2))


def split_seeds(split: str, count: int) -> range:
    """The first `count` seeds of a split. Raises BadInput for an unknown split, or too many."""
    if split not in SPLITS:
        raise BadInput(f"split: {split!r} is none of {', '.join(SPLITS)}")
    if not 1 <= count <= len(SPLITS[split]):
        raise BadInput(f"split {split}: {count} houses; 1 to {len(SPLITS[split])} are valid")
    return SPLITS[split][:count]


def draw_houses(house: House, seeds: Sequence[int], n_agents: int) -> Houses:
    """One house per seed, in order; a floor plan gives one house, whatever the seeds.

    Generated houses have one connected free region and more free cells than robots, or are drawn
    again. A floor plan keeps one region, see `keep_region`, and its first `n_agents` starts; where
    it gives fewer, the world draws the rest.

    Raises BadInput where the file or the settings allow no such house.
    """
    if not house.generated:
        return _stack([_loaded(house, n_agents)])
    if not seeds:
        raise BadInput("house: no seeds to draw houses from; at least one is needed")
    return _stack([_drawn(house, seed, n_agents) for seed in seeds])


def draw_bank(house: House, count: int, n_agents: int, split: str = "train") -> Houses:
    """Up to `count` distinct houses, from the first seeds of a split that give a new one.

    Settings that allow fewer (an open house of one size, a floor plan) give fewer: drawing ends
    when `count` seeds in a row gave no new house. Where shares count, as in a mixture, the houses
    are those of the first `count` seeds, duplicates included.

    Raises BadInput as `draw_houses` does.
    """
    split_seeds(split, count)
    if not house.generated or house.shares_count:
        return draw_houses(house, split_seeds(split, count), n_agents)
    bank: dict[tuple[tuple[int, ...], bytes], HouseLayout] = {}
    repeats = 0
    for seed in SPLITS[split]:
        layout = _drawn(house, seed, n_agents)
        content = layout.free.shape, layout.free.tobytes()
        repeats = repeats + 1 if content in bank else 0
        bank.setdefault(content, layout)
        if len(bank) == count or repeats == count:
            break
    return _stack(list(bank.values()))


def smallest_first(houses: Houses) -> Houses:
    """The same houses sorted by their free cells, smallest first; ties keep their order."""
    order = np.argsort(houses.free_cells, kind="stable")
    return Houses(
        free=houses.free[order],
        furniture=houses.furniture[order],
        rows=houses.rows[order],
        cols=houses.cols[order],
        starts=None if houses.starts is None else houses.starts[order],
        sources=[houses.sources[index] for index in order],
    )


def keep_region(layout: HouseLayout) -> HouseLayout:
    """The layout with one free region: that of its starts, or without starts the largest.

    Raises BadInput: no free cell, or starts in two regions.
    """
    return replace(layout, free=layout.regions().kept)


def stream(seed: int, draw: int) -> random.Random:
    """The random numbers of one draw of one seed, the same under any setting."""
    return random.Random(f"{seed}/{draw}")


def between(numbers: random.Random, low: int, high: int) -> int:
    """A uniform integer, both ends included.

    By `random()` alone, the one method whose sequence Python promises never to change.
    """
    return low + int(numbers.random() * (high - low + 1))


def check_range(key: str, value: Sequence[int], least: int) -> None:
    """Raises BadInput, naming `key`, unless `value` is [low, high] with least <= low <= high."""
    if len(value) != 2 or not least <= value[0] <= value[1]:
        raise BadInput(
            f"{key}: {list(value)} is not [low, high] with {least} <= low <= high; "
            f"[{least}, {least}] is the smallest"
        )


def _drawn(house: House, seed: int, n_agents: int) -> HouseLayout:
    for draw in range(DRAWS_PER_SEED):
        layout = house.layout(seed, draw)
        if ndimage.label(layout.free)[1] == 1 and np.count_nonzero(layout.free) > n_agents:
            return _with_starts_for(layout, n_agents)
    raise BadInput(
        f"house: in {DRAWS_PER_SEED} draws of seed {seed} none had one region of more than "
        f"{n_agents} free cells (env.n_agents), the last {np.count_nonzero(layout.free)} in all; "
        "raise house.rows or house.cols, or lower env.n_agents"
    )


def check_largest(largest_side: int, rows: int, cols: int) -> None:
    """Raises BadInput when a house of rows x cols is larger than `observation.largest_side`."""
    if max(rows, cols) > largest_side:
        raise BadInput(
            f"observation.largest_side={largest_side}: too small for houses of {rows}x{cols};"
            f" at least {max(rows, cols)} is needed, and a policy plays no larger houses than"
            " it was trained to see"
        )


def _loaded(house: House, n_agents: int) -> HouseLayout:
    layout = keep_region(house.layout(0))
    free_cells = int(np.count_nonzero(layout.free))
    if free_cells <= n_agents:
        reason = "clean at step 0" if free_cells == n_agents else "more robots than cells"
        valid = f"1 to {free_cells - 1}" if free_cells > 1 else "none, so take another floor plan"
        raise BadInput(
            f"{layout.source}: {reason}, free cells: {free_cells}, env.n_agents: {n_agents}; "
            f"valid for env.n_agents: {valid}"
        )
    return _with_starts_for(layout, n_agents)


def _with_starts_for(layout: HouseLayout, n_agents: int) -> HouseLayout:
    return replace(layout, starts=layout.starts[:n_agents] if layout.starts else None)


def _stack(layouts: Sequence[HouseLayout]) -> Houses:
    rows = np.array([layout.free.shape[0] for layout in layouts], dtype=np.int64)
    cols = np.array([layout.free.shape[1] for layout in layouts], dtype=np.int64)
    size = len(layouts), int(rows.max()), int(cols.max())
    free, furniture = np.zeros(size, dtype=bool), np.zeros(size, dtype=np.int16)
    for index, layout in enumerate(layouts):
        free[index, : rows[index], : cols[index]] = layout.free
        furniture[index, : rows[index], : cols[index]] = layout.furniture
    return Houses(
        free=free,
        furniture=furniture,
        rows=rows,
        cols=cols,
        starts=_stack_starts([layout.starts for layout in layouts]),
        sources=[layout.source for layout in layouts],
    )


def _stack_starts(starts: Sequence[tuple[tuple[int, int], ...] | None]) -> np.ndarray | None:
    most = max(len(cells or ()) for cells in starts)
    if not most:
        return None
    stacked = np.full((len(starts), most, 2), -1, dtype=np.int64)
    for index, cells in enumerate(starts):
        if cells:
            stacked[index, : len(cells)] = cells
    return stacked
