"""What every house must hold."""

import random
from typing import Any

import numpy as np

from marl_clean.errors import BadInput
from marl_clean.house.base import House, HouseLayout, draw_houses
from marl_clean.settings import LARGEST_SIDE
from marl_clean.testing._broken import Clause, ContractBroken, require, verify
from marl_clean.testing._levels import Level, Maker, maker

SEEDS = (0, 1, 2, 999_999, 2_000_000)
DRAWS = (0, 1, 7)
HOUSES, N_AGENTS = 12, 2


def check_house(level: Level, **settings: Any) -> None:
    """A house draws layouts for robots to clean, each a function of its seed.

    By name, as on the command line, with settings changed; or by class with its settings:

        >>> check_house("rooms", rows=[9, 12])
        >>> from marl_clean.house.open import Open
        >>> check_house(Open, rows=[3, 4], cols=[5, 5])

    Raises:
        ContractBroken: what does not hold, with the layout's numbers.
        BadInput: no such level or setting.
    """
    made = maker("house", level, settings)
    verify(made.label, CLAUSES, made)


def layouts_are_grids_of_cells(make: Maker) -> None:
    """A layout is a grid of free cells and, on blocked ones, furniture; starts are free cells."""
    house = make()
    for seed in SEEDS:
        for draw in DRAWS:
            _check_layout(house, house.layout(seed, draw), seed, f"layout({seed}, draw={draw})")


def _check_layout(house: House, layout: HouseLayout, seed: int, name: str) -> None:
    free, furniture = layout.free, layout.furniture
    kind = f"{free.dtype} {list(free.shape)}"
    require(free.dtype == np.bool_ and free.ndim == 2, f"{name}.free is {kind}, not bool [r, c]")
    require(0 < min(free.shape) <= max(free.shape) <= LARGEST_SIDE, f"{name}.free is {kind}")
    fits = furniture.dtype == np.int16 and furniture.shape == free.shape
    require(fits, f"{name}.furniture is {furniture.dtype} {list(furniture.shape)}, free {kind}")
    require(int(furniture.min()) >= 0, f"{name}.furniture holds {furniture.min()}; 0 is none")
    both = np.argwhere(free & (furniture > 0))
    require(len(both) == 0, f"{name}: (row, col) {both[:1].tolist()} is free and furniture")
    if house.generated:
        require(layout.source == seed, f"{name}.source is {layout.source!r}, not the seed")
    else:
        require(isinstance(layout.source, str), f"{name}.source is {layout.source!r}, not a path")
    starts = layout.starts or ()
    require(len(set(starts)) == len(starts), f"{name}.starts has a cell twice: {starts}")
    for row, col in starts:
        inside = 0 <= row < free.shape[0] and 0 <= col < free.shape[1]
        require(inside and bool(free[row, col]), f"{name}: start {(row, col)} is no free cell")


def a_layout_is_a_function_of_seed_and_draw(make: Maker) -> None:
    """The same seed and draw give the same layout, whatever was drawn before; a file has one."""
    house, other = make(), make()
    layouts = {(seed, draw): house.layout(seed, draw) for seed in SEEDS for draw in DRAWS}
    before = random.getstate(), np.random.get_state()
    random.seed(1)
    np.random.seed(1)
    for seed, draw in reversed(list(layouts)):
        expected = layouts[seed, draw] if house.generated else layouts[SEEDS[0], 0]
        for layout in (other.layout(seed, draw), house.layout(seed, draw)):
            _require_same(layout, expected, f"layout({seed}, draw={draw})")
    random.setstate(before[0])
    np.random.set_state(before[1])


def _require_same(layout: HouseLayout, expected: HouseLayout, name: str) -> None:
    again = "when drawn again, after others and with other global random numbers"
    shapes = f"{list(layout.free.shape)}, not {list(expected.free.shape)}"
    require(layout.free.shape == expected.free.shape, f"{name} differs {again}: {shapes}")
    for field in ("free", "furniture"):
        differs = np.argwhere(getattr(layout, field) != getattr(expected, field))
        where = f"{len(differs)} cells of {field} differ, first {differs[:1].tolist()}"
        require(len(differs) == 0, f"{name} differs {again}: {where}")
    same = (layout.starts, layout.source) == (expected.starts, expected.source)
    require(same, f"{name} has other starts or another source {again}")


def houses_have_room_for_robots(make: Maker) -> None:
    """Every seed gives, within its draws, a house of one region with room for robots."""
    for house in make().parts():
        require(isinstance(house, House), f"parts() holds {house!r}, which is no House")
    try:
        houses = draw_houses(make(), range(HOUSES), N_AGENTS)
    except BadInput as error:
        raise ContractBroken(f"seeds 0 to {HOUSES - 1} for {N_AGENTS} robots: {error}") from None
    fewest = int(houses.free_cells.min())
    require(fewest > N_AGENTS, f"a house of {fewest} free cells for {N_AGENTS} robots")


CLAUSES: tuple[Clause, ...] = (
    layouts_are_grids_of_cells,
    a_layout_is_a_function_of_seed_and_draw,
    houses_have_room_for_robots,
)
