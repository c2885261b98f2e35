"""An empty floor without walls of its own."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from marl_clean.house.base import House, HouseLayout, between, check_range, stream
from marl_clean.settings import Range


@final
@dataclass(frozen=True)
class Open(House):
    """Every cell of rows x cols is free; the world's own ring is the wall. 1xN works.

    Raises BadInput for an invalid range.
    """

    generated: ClassVar[bool] = True

    rows: Range
    cols: Range

    def __post_init__(self) -> None:
        check_range("house.rows", self.rows, least=1)
        check_range("house.cols", self.cols, least=1)

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        """An empty floor whose size is a pure function of the seed and the draw."""
        numbers = stream(seed, draw)
        shape = between(numbers, *self.rows), between(numbers, *self.cols)
        furniture = np.zeros(shape, dtype=np.int16)
        return HouseLayout(free=furniture == 0, furniture=furniture, starts=None, source=seed)
