"""Reads floor plan files: map_server, MovingAI, plain images.

Every reader returns Cells. All limits are checked before anything is decoded, and whatever is
wrong raises BadInput in one line. Torch-free.
"""

import math
import os
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import yaml

from marl_clean.errors import BadInput
from marl_clean.house._plan_files import is_file, read_lines, warn_once
from marl_clean.house._plan_images import STRIP_ROWS, WHITE, Pixels, read_pixels
from marl_clean.settings import LARGEST_SIDE
from marl_clean.storage.reading import read_bytes
from marl_clean.storage.safe_yaml import BASE, check_plain, reason_of

LARGEST_YAML_BYTES = 16 * 2**10
MILLION = 1_000_000
DEEPEST_YAML = 3
MAP_SERVER_KEYS = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")
FREE_FROM_GREY = 128
SAVED_UNKNOWN = 205  # the grey that map_saver writes for unknown cells
PASSABLE, IMPASSABLE = b".GS", b"@OTW"


@dataclass(frozen=True)
class Cells:
    """What a file says of every cell, bool [rows, cols], row 0 at the top.

    `unknown` cells are neither free nor wall: nothing was seen there. `doubt` is a warning that
    cells outside the house may count as free; None without such a doubt.
    """

    free: np.ndarray
    unknown: np.ndarray
    doubt: str | None = None


def read_map_server(file: Path, cell_metres: float) -> Cells:
    """A map_server yaml and its image, cut into cells of `cell_metres`, see `to_cells`.

    With p = 1 - grey/255 (grey/255 when `negate`): occupied when p >= `occupied_thresh`, free
    when p <= `free_thresh`, else unknown; a pixel with alpha below 255 is unknown. Colours count
    by their mean. Mode `scale` grades only what is neither free nor occupied, so it reads like
    `trinary`; `raw` is refused. `image` is a path relative to the yaml, inside its folder.
    """
    settings = _map_server_settings(file)
    mode = settings.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise BadInput(f"{file}: mode {reprlib.repr(mode)}; valid: trinary, scale")
    resolution = _number(file, "resolution", settings["resolution"])
    if resolution <= 0:
        raise BadInput(f"{file}: resolution {resolution}; metres a pixel, above 0")
    _warn_of_yaw(file, settings["origin"])
    image = _image_of(file, settings["image"])
    pixels = read_pixels(image)
    _warn_of_colours(image, pixels)
    darkness = np.arange(WHITE + 1) / WHITE
    if not _flag(file, "negate", settings["negate"]):
        darkness = 1 - darkness
    occupied_from, free_to = _thresholds(file, settings)
    free = (darkness <= free_to)[pixels.shade] & pixels.opaque
    occupied = (darkness >= occupied_from)[pixels.shade] & pixels.opaque
    free_cells = to_cells(file, free, occupied, resolution, cell_metres)
    without_wall = to_cells(file, ~occupied, occupied, resolution, cell_metres)
    doubt = None
    if (free & (pixels.shade == 3 * SAVED_UNKNOWN)).any():
        doubt = f"free_thresh {free_to:g}: grey {SAVED_UNKNOWN} counts as free here"
        doubt += ", 0.196 would make it unknown"
    return Cells(free_cells, without_wall & ~free_cells, doubt)


def read_movingai(file: Path) -> Cells:
    """A MovingAI `.map`: one character per cell, the first is row 0, column 0.

    `type`, `height R`, `width C`, `map`, then R rows of C characters: `.` `G` `S` passable,
    `@` `O` `T` `W` not.
    """
    lines = read_lines(file)
    header = [line.split() for line in lines[:4]]
    if [words[0] if words else b"" for words in header] != [b"type", b"height", b"width", b"map"]:
        raise BadInput(f"{file}, line 1: not MovingAI; lines type, height, width, map come first")
    rows, cols = (_side(file, number, header[number - 1]) for number in (2, 3))
    body = lines[4:]
    if len(body) != rows:
        raise BadInput(f"{file}, line 2: height {rows}, but {len(body)} rows follow")
    for number, line in enumerate(body, start=5):
        if len(line) != cols:
            raise BadInput(f"{file}, line {number}: {len(line)} characters, but width {cols}")
    grid = np.frombuffer(b"".join(body), dtype=np.uint8).reshape(rows, cols)
    unknown = np.argwhere(~np.isin(grid, list(PASSABLE + IMPASSABLE)))
    if len(unknown):
        row, col = unknown[0]
        raise BadInput(
            f"{file}, line {row + 5}, column {col + 1}: {chr(grid[row, col])!r}; "
            "valid: . G S passable, @ O T W not"
        )
    free = np.isin(grid, list(PASSABLE))
    return Cells(free, np.zeros_like(free))


def read_image(
    file: Path,
    cell_metres: float,
    pixel_metres: float | None,
    free_colours: Sequence[Sequence[int]] | None = None,
) -> Cells:
    """A plain image: free where the mean of the colours is at least 128 of 255, and opaque.

    With `free_colours`, pixels of one of these colours are free instead. A pixel is a cell; with
    `pixel_metres` the image is cut into cells of `cell_metres`.
    """
    pixels = read_pixels(file, free_colours or ())
    if free_colours is None:
        _warn_of_colours(file, pixels)
        free = (pixels.shade >= 3 * FREE_FROM_GREY) & pixels.opaque
    else:
        free = pixels.chosen & pixels.opaque
    if pixel_metres is None:
        return Cells(free, ~pixels.opaque)
    return Cells(
        to_cells(file, free, ~free, pixel_metres, cell_metres),
        to_cells(file, ~pixels.opaque, pixels.opaque, pixel_metres, cell_metres),
    )


def to_cells(
    file: Path, free: np.ndarray, occupied: np.ndarray, resolution: float, cell_metres: float
) -> np.ndarray:
    """Cuts an image of `resolution` metres a pixel into cells.

    Cells are anchored at the image's lower left corner and have the pixels whose centres lie in
    them; cells cut by the edge are dropped. A cell is free when at least half of its pixels are
    free and none is occupied. Where cells are finer than pixels, the pixel under the cell's
    centre decides. Raises BadInput for no whole cell, or too many.
    """
    # Exact fractions of the decimals as written: no centre falls off its cell by rounding.
    step = Fraction(str(cell_metres)) / Fraction(str(resolution))  # pixels along a cell
    rows, cols = (int(side // step) for side in free.shape)
    if not 1 <= min(rows, cols) <= max(rows, cols) <= LARGEST_SIDE:
        raise BadInput(
            f"{file}: {free.shape[0]} x {free.shape[1]} pixels of {resolution} m make "
            f"{_short(rows)} x {_short(cols)} cells of {cell_metres} m; 1 to {LARGEST_SIDE} a side "
            "are valid, see house.cell_metres"
        )
    free, occupied = free[::-1], occupied[::-1]  # from the bottom row up
    if step <= 1:
        under = np.ix_(_pixels_under_centres(rows, step), _pixels_under_centres(cols, step))
        return (free[under] & ~occupied[under])[::-1]
    bottoms = np.array(_first_pixels(rows + 1, step))
    *lefts, right = _first_pixels(cols + 1, step)
    cells = np.empty((rows, cols), dtype=bool)
    strip = max(1, int(STRIP_ROWS // step))
    for first in range(0, rows, strip):  # a strip at a time, for memory
        edges = bottoms[first : first + strip + 1]
        part = slice(edges[0], edges[-1]), slice(right)
        # Free pixels vote 1, others -1, and one that is occupied outvotes all.
        votes = np.where(occupied[part], -free.size, np.where(free[part], 1, -1))
        votes = np.add.reduceat(votes, edges[:-1] - edges[0], axis=0)
        cells[first : first + strip] = np.add.reduceat(votes, lefts, axis=1) >= 0
    return cells[::-1]


def _short(count: int) -> str:
    """A number of cells, of which there may be 300 digits."""
    return str(count) if count < MILLION else f"over {MILLION:,}"


def _first_pixels(count: int, step: Fraction) -> list[int]:
    """For each cell the first pixel whose centre lies at or after the cell's lower edge."""
    return [math.ceil(cell * step - Fraction(1, 2)) for cell in range(count)]


def _pixels_under_centres(count: int, step: Fraction) -> list[int]:
    """For each cell the pixel under its centre."""
    return [math.floor((cell + Fraction(1, 2)) * step) for cell in range(count)]


def _map_server_settings(file: Path) -> dict[str, object]:
    """The yaml as text, lists and mappings: no tags, no anchors, nothing is constructed."""
    try:
        text = read_bytes(file, LARGEST_YAML_BYTES).decode("utf-8")
        check_plain(text, file, DEEPEST_YAML)
        # The base loader knows less than the safe one: every scalar stays text.
        settings = yaml.load(text, Loader=BASE)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadInput(f"{file}: not yaml ({reason_of(error)})") from error
    if not isinstance(settings, dict):
        raise BadInput(f"{file}: not a map_server yaml; keys: {', '.join(MAP_SERVER_KEYS)}")
    missing = [key for key in MAP_SERVER_KEYS if key not in settings]
    if missing:
        raise BadInput(f"{file}: map_server's key {', '.join(missing)} is missing")
    return settings


def _number(file: Path, key: str, value: object) -> float:
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"{file}: {key} {reprlib.repr(value)} is not a number")
    return number


def _share(file: Path, key: str, value: object) -> float:
    number = _number(file, key, value)
    if not 0 <= number <= 1:
        raise BadInput(f"{file}: {key} {number} is not between 0 and 1")
    return number


def _thresholds(file: Path, settings: dict[str, object]) -> tuple[float, float]:
    """`occupied_thresh` and `free_thresh`, the second no larger than the first."""
    occupied, free = (
        _share(file, key, settings[key]) for key in ("occupied_thresh", "free_thresh")
    )
    if occupied < free:
        raise BadInput(
            f"{file}: occupied_thresh {occupied:g} is below free_thresh {free:g}, so that a pixel "
            "can be both; give an occupied_thresh that is no smaller"
        )
    return occupied, free


def _flag(file: Path, key: str, value: object) -> bool:
    flags = {"0": False, "1": True, "false": False, "true": True}
    if not isinstance(value, str) or value.lower() not in flags:
        raise BadInput(f"{file}: {key} {reprlib.repr(value)}; valid: 0, 1, false, true")
    return flags[value.lower()]


def _warn_of_yaw(file: Path, origin: object) -> None:
    if not isinstance(origin, list) or len(origin) != 3:
        raise BadInput(f"{file}: origin {reprlib.repr(origin)} is not [x, y, yaw]")
    yaw = [_number(file, "origin", value) for value in origin][2]
    if yaw != 0:
        warn_once(f"{file}: the yaw of {yaw} is ignored")


def _warn_of_colours(file: Path, pixels: Pixels) -> None:
    if pixels.mostly_coloured:
        warn_once(
            f"{file}: most of it is coloured, and colours count by their mean, so a light wall is "
            "free; for a plain image house.free_colours=[[R,G,B],...] names the floor's colours"
        )


def _image_of(file: Path, name: object) -> Path:
    if not isinstance(name, str) or not name or "\0" in name:
        raise BadInput(f"{file}: image {reprlib.repr(name)} is not a file name")
    folder = Path(os.path.realpath(file.parent))
    try:
        image = Path(os.path.realpath(folder / name))
    except ValueError as error:  # half of a surrogate pair
        raise BadInput(f"{file}: image {reprlib.repr(name)} is not a file name") from error
    if not image.is_relative_to(folder):
        raise BadInput(f"{file}: image {reprlib.repr(name)} lies outside the yaml's folder")
    if not is_file(image):
        raise BadInput(f"{file}: image {reprlib.repr(name)} is missing; expected in {folder}")
    return image


def _side(file: Path, number: int, words: list[bytes]) -> int:
    name, *values = words
    digits = values[0] if len(values) == 1 else b""
    side = int(digits) if digits.isdigit() and len(digits) <= len(str(LARGEST_SIDE)) else 0
    if not 1 <= side <= LARGEST_SIDE:
        raise BadInput(f"{file}, line {number}: {name.decode()} must be 1 to {LARGEST_SIDE}")
    return side
