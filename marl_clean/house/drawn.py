"""A house drawn in characters, one per cell."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, final

import numpy as np
from scipy import ndimage

from marl_clean.errors import BadInput
from marl_clean.house._plan_files import find_plan, read_lines
from marl_clean.house.base import House, HouseLayout
from marl_clean.settings import LARGEST_SIDE

SHIPPED = Path(__file__).parent / "plans"
WALL, FLOOR, ROBOT, NUMBERED = b"#", b". ", b"S", b"0123456789"
FURNITURE = b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRTUVWXYZ"  # without S, a robot
VALID = "valid: # wall, . or space floor, letters furniture, S or digits robots"


@final
@dataclass(frozen=True)
class Drawn(House):
    """A floor plan in an ASCII file: every line one row, every character one cell.

    `#` wall; `.` or space floor; a letter furniture, all cells of a letter one piece (a connected
    one; `A` and `a` are two); digits the floor under the robots at the start, in the order of the
    digits; `S` the same without an order, after the digits in reading order. `path` is relative to
    the working directory, or the name of a shipped one; None is the shipped apartment.

    Raises BadInput, with file, line and column: no file, empty, ragged, an unknown character, a
    digit drawn twice, a piece in two parts.
    """

    generated: ClassVar[bool] = False

    path: str | None = None

    def layout(self, seed: int = 0, draw: int = 0) -> HouseLayout:
        """The layout in the file, for every seed."""
        name = self.path or "apartment"
        file = find_plan(name, SHIPPED, (".txt",))
        grid = _grid(file)
        return HouseLayout(
            free=np.isin(grid, list(FLOOR + ROBOT + NUMBERED)),
            furniture=_furniture(file, grid),
            starts=_starts(file, grid),
            source=name,
        )


def _grid(file: Path) -> np.ndarray:
    """The file's characters, uint8 [rows, cols]."""
    lines = read_lines(file)
    if not lines or not lines[0]:
        raise BadInput(f"{file}, line 1, column 1: empty; {VALID}")
    if max(len(lines), len(lines[0])) > LARGEST_SIDE:
        raise BadInput(f"{file}: more than {LARGEST_SIDE} rows or columns")
    for number, line in enumerate(lines, start=1):
        if len(line) != len(lines[0]):
            raise BadInput(
                f"{file}, line {number}, column {min(len(line), len(lines[0])) + 1}: the line has "
                f"{len(line)} characters, line 1 has {len(lines[0])}; all must have the same"
            )
    grid = np.frombuffer(b"".join(lines), dtype=np.uint8).reshape(len(lines), len(lines[0]))
    unknown = np.argwhere(~np.isin(grid, list(WALL + FLOOR + ROBOT + NUMBERED + FURNITURE)))
    if len(unknown):
        raise BadInput(f"{_where(file, unknown[0])}: {chr(grid[tuple(unknown[0])])!r}; {VALID}")
    return grid


def _furniture(file: Path, grid: np.ndarray) -> np.ndarray:
    """Pieces numbered 1, 2, ... in reading order, int16 [rows, cols]."""
    letters, first = np.unique(grid, return_index=True)
    drawn = [int(letters[index]) for index in np.argsort(first) if letters[index] in FURNITURE]
    furniture = np.zeros(grid.shape, dtype=np.int16)
    for number, letter in enumerate(drawn, start=1):
        parts, count = ndimage.label(grid == letter)
        if count > 1:
            second = np.argwhere(parts == 2)[0]
            raise BadInput(
                f"{_where(file, second)}: a second part of piece {chr(letter)!r}; "
                "one letter is one piece, give it another letter"
            )
        furniture[parts == 1] = number
    return furniture


def _starts(file: Path, grid: np.ndarray) -> tuple[tuple[int, int], ...] | None:
    """Cells of the digits in their order, then of each S in reading order; None without any."""
    starts: list[tuple[int, int]] = []
    for mark in NUMBERED + ROBOT:
        cells = np.argwhere(grid == mark)
        if len(cells) > 1 and mark in NUMBERED:
            raise BadInput(
                f"{_where(file, cells[1])}: robot {chr(mark)} a second time; "
                "each digit is one robot, S any number"
            )
        starts.extend((int(row), int(col)) for row, col in cells)
    return tuple(starts) or None


def _where(file: Path, cell: np.ndarray) -> str:
    return f"{file}, line {cell[0] + 1}, column {cell[1] + 1}"
