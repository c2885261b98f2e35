"""Houses of rectangular rooms with doors and furniture, a new one for every seed."""

import random
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, final

import numpy as np

from marl_clean.errors import BadInput
from marl_clean.house.base import House, HouseLayout, between, check_range, stream
from marl_clean.settings import PositiveInt, Probability, Range

WALL, FREE = -1, 0  # a positive cell holds the number of its piece of furniture
MOST_PIECES = 2**15 - 1  # what int16 holds
TRIES_PER_PIECE = 5
CELLS_BETWEEN_DOORS = 3

Grid = list[list[int]]


class Box(NamedTuple):
    """A rectangle of rows top to bottom - 1 and columns left to right - 1."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def cells(self) -> int:
        return (self.bottom - self.top) * (self.right - self.left)


@final
@dataclass(frozen=True)
class Rooms(House):
    """Recursive division: a wall with doors halves a room until the rooms are small enough.

    The outermost cells of rows x cols are walls. Doors are one cell wide; no wall ends at a
    door. Furniture is rectangles. The free cells always stay one region: a wall has a door, and a
    piece stands only where the free cells around it form one unbroken run, so that every path
    through its place can lead around it.

    Paper §3.1 (rectangular shapes and obstacles), §3.4 (thousands of different houses).
    Raises BadInput for an invalid range, or a house without room between its walls.
    """

    generated: ClassVar[bool] = True

    rows: Range
    cols: Range
    smallest_room: PositiveInt = 3
    largest_room: PositiveInt = 50
    divide: Probability = 0.35
    doors: Range = field(default_factory=lambda: [1, 2])
    cells_per_piece: Range = field(default_factory=lambda: [10, 18])
    piece_sides: Range = field(default_factory=lambda: [1, 3])
    against_wall: Probability = 0.7

    def __post_init__(self) -> None:
        check_range("house.rows", self.rows, least=3)
        check_range("house.cols", self.cols, least=3)
        for key in ("doors", "cells_per_piece", "piece_sides"):
            check_range(f"house.{key}", getattr(self, key), least=1)

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        """A house that is a pure function of the seed and the draw."""
        numbers = stream(seed, draw)
        rows, cols = between(numbers, *self.rows), between(numbers, *self.cols)
        inner = [WALL] + [FREE] * (cols - 2) + [WALL]
        grid = [[WALL] * cols, *(inner.copy() for _ in range(rows - 2)), [WALL] * cols]
        pieces = 0
        for room in self._divided(grid, Box(1, 1, rows - 1, cols - 1), numbers):
            pieces = self._furnish(grid, room, pieces, numbers)
        if pieces > MOST_PIECES:
            raise BadInput(
                f"house.cells_per_piece: {pieces:,} pieces of furniture in {rows}x{cols} cells, and"
                f" at most {MOST_PIECES:,} are told apart; give smaller houses or fewer pieces"
            )
        cells = np.array(grid, dtype=np.int16)
        furniture = np.maximum(cells, 0)
        return HouseLayout(free=cells == FREE, furniture=furniture, starts=None, source=seed)

    def _divided(self, grid: Grid, room: Box, numbers: random.Random) -> list[Box]:
        """The rooms that `room` becomes, in reading order; writes walls and doors in place."""
        if room.cells <= self.largest_room and numbers.random() >= self.divide:
            return [room]
        top, left, bottom, right = room
        # The longer a side, the likelier it is cut.
        cut_rows = numbers.random() * (bottom - top + right - left) < bottom - top
        places = self._wall_places(grid, room, cut_rows)
        if not places:
            cut_rows = not cut_rows
            places = self._wall_places(grid, room, cut_rows)
        if not places:
            return [room]
        at = places[between(numbers, 0, len(places) - 1)]
        if cut_rows:
            wall = [(at, col) for col in range(left, right)]
            halves = Box(top, left, at, right), Box(at + 1, left, bottom, right)
        else:
            wall = [(row, at) for row in range(top, bottom)]
            halves = Box(top, left, bottom, at), Box(top, at + 1, bottom, right)
        doors = self._doors(len(wall), numbers)
        for index, (row, col) in enumerate(wall):
            grid[row][col] = FREE if index in doors else WALL
        return [part for half in halves for part in self._divided(grid, half, numbers)]

    def _wall_places(self, grid: Grid, room: Box, cut_rows: bool) -> list[int]:
        """Rows (or columns) where a wall leaves both halves wide enough and ends at no door."""
        top, left, bottom, right = room
        if cut_rows:
            return [
                row
                for row in range(top + self.smallest_room, bottom - self.smallest_room)
                if grid[row][left - 1] == WALL and grid[row][right] == WALL
            ]
        return [
            col
            for col in range(left + self.smallest_room, right - self.smallest_room)
            if grid[top - 1][col] == WALL and grid[bottom][col] == WALL
        ]

    def _doors(self, wall_cells: int, numbers: random.Random) -> list[int]:
        """Where a wall has its doors: at least one, no two near each other."""
        doors: list[int] = []
        places = list(range(wall_cells))
        for _ in range(between(numbers, *self.doors)):
            if places:
                door = places[between(numbers, 0, len(places) - 1)]
                doors.append(door)
                places = [place for place in places if abs(place - door) > CELLS_BETWEEN_DOORS]
        return doors

    def _furnish(self, grid: Grid, room: Box, pieces: int, numbers: random.Random) -> int:
        """Puts pieces into a room in place, numbered from `pieces` + 1; returns the last number."""
        for _ in range(room.cells // between(numbers, *self.cells_per_piece)):
            for _ in range(TRIES_PER_PIECE):
                piece = self._piece(room, numbers)
                if _fits(grid, piece):
                    pieces += 1
                    for row in range(piece.top, piece.bottom):
                        for col in range(piece.left, piece.right):
                            grid[row][col] = pieces
                    break
        return pieces

    def _piece(self, room: Box, numbers: random.Random) -> Box:
        """A rectangle in the room, no side longer than half the room's, often along a wall."""
        top, left, bottom, right = room
        height = min(between(numbers, *self.piece_sides), max((bottom - top) // 2, 1))
        width = min(between(numbers, *self.piece_sides), max((right - left) // 2, 1))
        row = between(numbers, top, bottom - height)
        col = between(numbers, left, right - width)
        if numbers.random() < self.against_wall:
            side = between(numbers, 0, 3)
            if side < 2:
                row = (top, bottom - height)[side]
            else:
                col = (left, right - width)[side - 2]
        return Box(row, col, row + height, col + width)


def _fits(grid: Grid, piece: Box) -> bool:
    """Whether the place is free and the free cells around it form one unbroken run."""
    top, left, bottom, right = piece
    for row in range(top, bottom):
        if any(grid[row][left:right]):
            return False
    above, below = grid[top - 1][left - 1 : right + 1], grid[bottom][left - 1 : right + 1]
    down = [grid[row][right] for row in range(top, bottom)]
    up = [grid[row][left - 1] for row in range(bottom - 1, top - 1, -1)]
    ring = [*above, *down, *reversed(below), *up]
    starts = sum(
        cell == FREE and before != FREE
        for before, cell in zip([ring[-1], *ring], ring, strict=False)
    )
    return starts == 1 or not any(ring)
