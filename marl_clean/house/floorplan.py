"""A house from a floor plan file: map_server, MovingAI or a plain image."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, final

import numpy as np

from marl_clean.errors import BadInput
from marl_clean.house._floorplan_readers import (
    Cells,
    read_image,
    read_map_server,
    read_movingai,
)
from marl_clean.house._plan_files import find_plan, warn_once
from marl_clean.house.base import House, HouseLayout
from marl_clean.settings import Colours, PositiveFloat

SHIPPED = Path(__file__).parent / "plans"
MAP_SERVER, MOVINGAI = (".yaml", ".yml"), (".map",)
IMAGES = (".png", ".pgm", ".ppm", ".pbm", ".bmp", ".jpg", ".jpeg")
SUFFIXES = MAP_SERVER + MOVINGAI + IMAGES


@final
@dataclass(frozen=True)
class FloorPlan(House):
    """A floor plan from a file; the suffix tells its format. Scans show no furniture.

    `.yaml`, `.yml`: map_server, cut into cells of `cell_metres`. `.map`: MovingAI, one character
    per cell. An image: free from grey 128 on, or where it has one of `free_colours` (red, green,
    blue, of 255); one pixel per cell, or with `pixel_metres` cut into cells of `cell_metres`.
    `path` is relative to the working directory, or the name of a shipped floor plan. `starts` are
    (row, col) of robots; their region is the house, without starts the largest one.

    Raises BadInput: no path, no such file, one that cannot be read, a start that is not on a free
    cell, `free_colours` for a file that is not a plain image.
    """

    generated: ClassVar[bool] = False

    path: str | None
    cell_metres: PositiveFloat = 0.4
    pixel_metres: PositiveFloat | None = None
    starts: list[list[int]] | None = None
    free_colours: Colours | None = None

    def __post_init__(self) -> None:
        if not self.path:
            raise BadInput(
                f"house.path: null; valid: apartment (shipped), or a file on {', '.join(SUFFIXES)}"
            )
        for key in ("cell_metres", "pixel_metres"):
            metres = getattr(self, key)
            if metres is not None and not (math.isfinite(metres) and metres > 0):
                raise BadInput(f"house.{key}: {metres} is not a length above 0")

    def layout(self, seed: int = 0, draw: int = 0) -> HouseLayout:
        """The layout in the file, for every seed."""
        path = str(self.path)
        file = find_plan(path, SHIPPED, SUFFIXES)
        cells = self._read(file)
        layout = HouseLayout(
            free=cells.free,
            furniture=np.zeros(cells.free.shape, dtype=np.int16),
            starts=self._starts(cells.free),
            source=path,
            unknown=cells.unknown,
            cell_metres=self._cell_metres(file),
        )
        if cells.doubt is not None:
            regions = layout.regions()
            warn_once(
                f"{file}: {cells.doubt}; {regions.edge_cells:,} of the region's "
                f"{regions.kept_cells:,} cells lie on the edge of the plan"
            )
        return layout

    def _read(self, file: Path) -> Cells:
        suffix = file.suffix.lower()
        if suffix in IMAGES:
            return read_image(file, self.cell_metres, self.pixel_metres, self.free_colours)
        if self.free_colours is not None:
            raise BadInput(f"house.free_colours: {self.path} is no plain image; leave it null")
        if suffix in MAP_SERVER:
            return read_map_server(file, self.cell_metres)
        return read_movingai(file)

    def _cell_metres(self, file: Path) -> float | None:
        """The side of a cell, where the file or the settings give its scale."""
        suffix = file.suffix.lower()
        scaled = suffix in MAP_SERVER or (suffix in IMAGES and self.pixel_metres is not None)
        return self.cell_metres if scaled else None

    def _starts(self, free: np.ndarray) -> tuple[tuple[int, int], ...] | None:
        starts: list[tuple[int, int]] = []
        rows, cols = free.shape
        for place in self.starts or []:
            inside = len(place) == 2 and 0 <= place[0] < rows and 0 <= place[1] < cols
            if not inside or not free[place[0], place[1]] or (place[0], place[1]) in starts:
                raise BadInput(
                    f"house.starts: {list(place)} is blocked, outside the {rows} x {cols} cells "
                    "or given twice; valid: [row, col] of free cells"
                )
            starts.append((place[0], place[1]))
        return tuple(starts) or None
