"""Houses of many sizes and kinds, and floor plans from files among them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, final

import numpy as np

from marl_clean.errors import BadInput
from marl_clean.house.base import House, HouseLayout, between, check_range, keep_region, stream
from marl_clean.house.drawn import SHIPPED, Drawn
from marl_clean.house.floorplan import FloorPlan
from marl_clean.house.open import Open
from marl_clean.house.rooms import Rooms
from marl_clean.settings import LARGEST_SIDE, Kinds, Margins, Probability, Range, Ranges

CHOICE = -1  # the draw number that picks a seed's part; draws of houses count from 0
MARGINS = -2  # the draw number that decides what lies around it


@final
@dataclass(frozen=True)
class Mixture(House):
    """Every seed picks a range of sizes and a kind of house, or one of the floor plans.

    With probability `plans_share` one of `plans`, uniformly; else one of `sides` and one of
    `kinds`, uniformly over the entries of each list, so that an entry listed twice comes twice as
    often. `rooms` are those of `house=rooms`, `single_room` the same without dividing walls,
    `cluttered` with twice as many pieces of furniture, smaller ones, which leave narrow gaps,
    `open` floors without walls. Around a generated house lie blocked cells, as around the rooms of
    a scanned plan: one of `margins` is picked, and each side's number of them drawn from it. A
    `.txt` among `plans` is read as `house=drawn` reads it, any other file as `house=floorplan`
    does; a shipped name is the drawn one, whose furniture can move. The part depends on the seed
    alone, so that a redraw stays within its part.

    Paper §3.4 (thousands of different environments, which vary on sizes and room plans).
    Raises BadInput for an invalid range, or a floor plan that cannot be used.
    """

    generated: ClassVar[bool] = True
    shares_count: ClassVar[bool] = True

    sides: Ranges
    kinds: Kinds = field(default_factory=lambda: ["rooms"])
    margins: Margins = field(default_factory=lambda: [[0, 0]])
    plans: list[str] = field(default_factory=list)
    plans_share: Probability = 0.1

    def __post_init__(self) -> None:
        for sides in self.sides:
            check_range("house.sides", sides, least=3)
        for margins in self.margins:
            check_range("house.margins", margins, least=0)
        for file in self._files:
            _read(file)

    def parts(self) -> Sequence[House]:
        """Every floor plan, and every kind in every range of sizes."""
        return [*self._files, *self._generators]

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        """The layout of the part that the seed picks: a pure function of the seed and the draw."""
        numbers = stream(seed, CHOICE)
        if numbers.random() < self.plans_share and self.plans:
            return self._loaded[between(numbers, 0, len(self.plans) - 1)]
        generators = self._generators
        layout = generators[between(numbers, 0, len(generators) - 1)].layout(seed, draw)
        return _surrounded(layout, self._margins(seed))

    def _margins(self, seed: int) -> list[int]:
        """Blocked cells above, below, left and right of the house of a seed."""
        numbers = stream(seed, MARGINS)
        low, high = self.margins[between(numbers, 0, len(self.margins) - 1)]
        return [between(numbers, low, high) for _ in range(4)]

    @cached_property
    def _generators(self) -> list[House]:
        return [_generator(kind, sides) for sides in self.sides for kind in self.kinds]

    @cached_property
    def _files(self) -> list[House]:
        return [_file(path) for path in self.plans]

    @cached_property
    def _loaded(self) -> list[HouseLayout]:
        return [_read(file) for file in self._files]


def _generator(kind: str, sides: Range) -> House:
    match kind:
        case "rooms":
            return Rooms(sides, sides)
        case "single_room":
            return Rooms(sides, sides, largest_room=LARGEST_SIDE**2, divide=0.0)
        case "cluttered":
            return Rooms(sides, sides, cells_per_piece=[5, 9], piece_sides=[1, 2])
        case "open":
            return Open(sides, sides)
    raise ValueError(kind)


def _surrounded(layout: HouseLayout, margins: list[int]) -> HouseLayout:
    above, below, left, right = margins
    sides = (above, below), (left, right)
    return replace(
        layout, free=np.pad(layout.free, sides), furniture=np.pad(layout.furniture, sides)
    )


def _file(path: str) -> House:
    drawn = Path(path).suffix == ".txt" or (SHIPPED / f"{path}.txt").is_file()
    return Drawn(path) if drawn else FloorPlan(path)


def _read(file: House) -> HouseLayout:
    try:
        return keep_region(file.layout(0))
    except BadInput as error:
        raise BadInput(f"house.plans: {error}") from None
