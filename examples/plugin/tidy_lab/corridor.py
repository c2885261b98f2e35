"""An office floor: one corridor, and rooms on both sides of it."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from marl_clean.house.base import House, HouseLayout, between, check_range, stream
from marl_clean.settings import PositiveInt, Range


@final
@dataclass(frozen=True)
class Corridor(House):
    """A corridor one cell wide with rooms on both sides, each behind a door of its own.

    How many rooms there are and where the doors are is drawn from the seed; without furniture.
    Raises BadInput for a range that is none.
    """

    generated: ClassVar[bool] = True

    rooms: Range
    width: PositiveInt
    depth: PositiveInt

    def __post_init__(self) -> None:
        check_range("house.rooms", self.rooms, least=1)

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        """The floor of a seed, and of nothing else."""
        numbers = stream(seed, draw)
        count, middle = between(numbers, *self.rooms), self.depth + 2
        free = np.zeros((2 * self.depth + 5, count * (self.width + 1) + 1), dtype=bool)
        free[middle, 1:-1] = True
        for left in range(1, free.shape[1], self.width + 1):
            for rows, wall in ((slice(1, middle - 1), -1), (slice(middle + 2, -1), 1)):
                free[rows, left : left + self.width] = True
                free[middle + wall, left + between(numbers, 0, self.width - 1)] = True
        furniture = np.zeros(free.shape, dtype=np.int16)
        return HouseLayout(free=free, furniture=furniture, starts=None, source=seed)
