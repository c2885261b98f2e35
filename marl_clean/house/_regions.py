"""Which of a floor plan's free cells are the house, and what is left out. NumPy and SciPy only."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from marl_clean.errors import BadInput


@dataclass(frozen=True)
class Regions:
    """The free cells of a floor plan: the one region that is the house, and all others.

    `kept` and `left_out` are bool [rows, cols]; `num_left_out` counts regions.
    """

    kept: np.ndarray
    left_out: np.ndarray
    num_left_out: int

    @property
    def kept_cells(self) -> int:
        """Cells of the house."""
        return int(np.count_nonzero(self.kept))

    @property
    def edge_cells(self) -> int:
        """Cells of the house in the first or last row or column, where no wall can enclose them."""
        inner = self.kept[1:-1, 1:-1]
        return self.kept_cells - int(np.count_nonzero(inner))

    def describe(self, cell_metres: float | None) -> str:
        """Size, free cells, cells left out and cells on the edge, as one line."""
        rows, cols = self.kept.shape
        side = "" if cell_metres is None else f" of {cell_metres:g} m"
        parts = [f"{rows:,} x {cols:,} cells{side}", f"{self.kept_cells:,} free in one region"]
        if self.num_left_out:
            cells = int(np.count_nonzero(self.left_out))
            parts.append(
                f"{_number(cells, 'free cell')} in "
                f"{_number(self.num_left_out, 'other region')} left out"
            )
        if self.edge_cells:
            parts.append(f"{self.edge_cells:,} of the region on the edge of the plan")
        return ", ".join(parts)


def split_regions(
    free: np.ndarray, starts: tuple[tuple[int, int], ...] | None, source: int | str
) -> Regions:
    """The region of the starts, or without starts the largest, and all free cells outside it.

    Of equally large regions it is the one with the smallest (row, col). Cells connect by their
    four sides. Raises BadInput: no free cell, or starts in two regions.
    """
    regions, count = ndimage.label(free)
    if count == 0:
        raise BadInput(f"{source}: the floor plan has no free cell; at least one is needed")
    if starts:
        kept = regions[starts[0]]
        for start in starts:
            if regions[start] != kept:
                raise BadInput(
                    f"{source}: the starts {starts[0]} and {start} (row, col) lie in two "
                    "regions; all starts must lie in one"
                )
    else:
        # Regions are numbered in reading order, so argmax breaks ties as the docstring says.
        kept = 1 + np.argmax(np.bincount(regions.ravel())[1:])
    return Regions(regions == kept, (regions > 0) & (regions != kept), count - 1)


def _number(count: int, thing: str) -> str:
    return f"{count:,} {thing}" if count == 1 else f"{count:,} {thing}s"
