"""One step of an episode as a picture: the house beside the robots' map.

NumPy and Pillow only, so that the environment, the reports and the terminal share it.
The same scene gives the same pixels, and every frame of an episode has the same size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

Colour = tuple[int, int, int]
Place = tuple[int, int]
Point = tuple[float, float]  # of a place, in cells of a picture that may be smaller than the house

PAGE: Colour = (255, 255, 255)
INK: Colour = (38, 43, 51)
FAINT: Colour = (214, 218, 224)
WALL: Colour = (58, 66, 78)
FURNITURE: Colour = (150, 118, 92)
DIRTY: Colour = (222, 203, 164)
CLEAN: Colour = (168, 222, 209)
SPILT: Colour = (201, 162, 39)
UNKNOWN: Colour = (158, 163, 171)
BLOCKED: Colour = (17, 19, 23)
CONTACT: Colour = (112, 48, 190)
# Okabe and Ito's colours, which colour-blind readers can distinguish; the ninth robot starts again.
ROBOTS: tuple[Colour, ...] = (
    (0, 114, 178), (213, 94, 0), (0, 140, 102), (178, 76, 132),
    (176, 128, 0), (46, 134, 193), (120, 66, 18), (60, 60, 60),
)  # fmt: skip

FRESH = 0.5  # the map's value of a cell cleaned this very step (paper §3.2)
SUPERSAMPLE = 3  # drawn this many times larger, then averaged down: smooth discs and lines
MARGIN, GAP, TITLE, CAPTION = 14, 22, 22, 34  # pixels
CAPTION_WIDTH = 300  # pixels the caption needs, whatever the house's width
FRAME = 2  # pixels around each panel
SMALLEST_DISC = 13  # pixels; below this a robot's number cannot be read
LARGEST_CELL = 24  # pixels
PANEL_PIXELS = 640  # the longer side of a panel, about
MOST_CELLS = 1024  # a panel's longer side; of a larger house, a cell shows the mean of several


@dataclass(frozen=True)
class Scene:
    """What one picture shows; all matrices have the same R x C, places are `(row, col)`.

    `values` are the map's: -1 blocked, -0.2 unknown, 0 (dirty) to 0.5 (just cleaned) available.
    A robot's own 1 is drawn as available: the disc shows which robot stands there.
    """

    free: Bool[np.ndarray, "row col"]
    furniture: Int[np.ndarray, "row col"]
    cleaned: Bool[np.ndarray, "row col"]
    values: Float[np.ndarray, "row col"]
    positions: Sequence[Place]
    step: int
    coverage: float
    contacts: Sequence[tuple[int, int]] = field(default=())
    map_title: str = "shared map"
    spilt: Bool[np.ndarray, "row col"] | None = None  # cleaned, and dirty again by a spill


@dataclass(frozen=True)
class Layout:
    """Where things lie in the picture, in its pixels; it depends on the house's shape alone."""

    rows: int
    cols: int
    cell_pixels: int

    @property
    def width(self) -> int:
        """Wide enough for the two panels and for the caption."""
        return 2 * MARGIN + max(2 * self.cols * self.cell_pixels + GAP, CAPTION_WIDTH)

    @property
    def height(self) -> int:
        """Title, panels and caption."""
        return MARGIN + TITLE + self.rows * self.cell_pixels + CAPTION + MARGIN // 2

    def corner(self, panel: int) -> Place:
        """Top left pixel of panel 0 (house) or 1 (map)."""
        panel_width = self.cols * self.cell_pixels
        left = (self.width - 2 * panel_width - GAP) // 2
        return MARGIN + TITLE, left + panel * (panel_width + GAP)

    def centre(self, panel: int, place: Place | Point) -> Point:
        """Centre of a cell in a panel, as (row, col) of pixels."""
        top, left = self.corner(panel)
        row, col = place
        return top + (row + 0.5) * self.cell_pixels, left + (col + 0.5) * self.cell_pixels


def fitting_cell(rows: int, cols: int, panel_pixels: int = PANEL_PIXELS) -> int:
    """The side of a cell, in pixels, that makes a panel's longer side about `panel_pixels`."""
    return min(max(panel_pixels // max(rows, cols), 1), LARGEST_CELL)


def draw(scene: Scene, cell_pixels: int | None = None) -> UInt8[np.ndarray, "height width 3"]:
    """The house, the map, the robots and their contacts side by side, as RGB.

    `cell_pixels`: the side of a cell; None: chosen by the house. A panel has at most MOST_CELLS
    cells a side, so the picture's size is bounded whatever the house's.
    """
    shrink = -(-max(scene.free.shape) // MOST_CELLS)
    rows, cols = (-(-side // shrink) for side in scene.free.shape)
    cell_pixels = cell_pixels or fitting_cell(rows, cols)
    layout = Layout(rows, cols, cell_pixels)
    places = [(row / shrink, col / shrink) for row, col in scene.positions]
    page = np.full((layout.height, layout.width, 3), PAGE, dtype=np.uint8)
    for panel, colours in enumerate((house_colours(scene), map_colours(scene.values))):
        colours = colours if shrink == 1 else np.asarray(Image.fromarray(colours).reduce(shrink))
        top, left = layout.corner(panel)
        frame = slice(top - FRAME, None), slice(left - FRAME, None)  # a house may end without walls
        height, width = rows * cell_pixels + 2 * FRAME, cols * cell_pixels + 2 * FRAME
        page[frame][:height, :width] = WALL
        cells = _with_grid(colours.repeat(cell_pixels, 0).repeat(cell_pixels, 1), cell_pixels)
        page[top : top + cells.shape[0], left : left + cells.shape[1]] = cells
    large = Image.fromarray(page).resize(
        (layout.width * SUPERSAMPLE, layout.height * SUPERSAMPLE), Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(large)
    for panel, title in enumerate(("house", scene.map_title)):
        _title(pen, layout, panel, title)
        _contacts(pen, layout, panel, scene.contacts, places)
        _robots(pen, layout, panel, places)
    _caption(pen, layout, scene)
    return np.asarray(large.reduce(SUPERSAMPLE))


def house_colours(scene: Scene) -> UInt8[np.ndarray, "row col 3"]:
    """The truth, a colour a cell: walls, furniture, dirty and cleaned floor."""
    colours = np.empty((*scene.free.shape, 3), dtype=np.uint8)
    colours[~scene.free] = WALL
    colours[~scene.free & (scene.furniture > 0)] = FURNITURE
    colours[scene.free] = DIRTY
    colours[scene.free & scene.cleaned] = CLEAN
    if scene.spilt is not None:
        colours[scene.spilt] = SPILT
    return colours


def map_colours(values: Float[np.ndarray, "row col"]) -> UInt8[np.ndarray, "row col 3"]:
    """The robots' memory, a colour a cell: the cleaner, the nearer to the colour of clean."""
    colours = np.empty((*values.shape, 3), dtype=np.uint8)
    for line, row in zip(colours, values, strict=True):  # of a whole large map: gigabytes
        freshness = np.clip(row / FRESH, 0.0, 1.0)[:, None]
        line[:] = np.rint((1.0 - freshness) * np.array(DIRTY) + freshness * np.array(CLEAN))
    colours[values < 0] = UNKNOWN
    colours[values <= -1] = BLOCKED
    return colours


def robot_colour(robot: int) -> Colour:
    """Robot i's colour in every picture."""
    return ROBOTS[robot % len(ROBOTS)]


def _with_grid(cells: np.ndarray, cell_pixels: int) -> np.ndarray:
    """A hairline, a little darker than the cell it crosses, where cells are large enough."""
    if cell_pixels >= 8:
        for lines in (cells[::cell_pixels], cells[:, ::cell_pixels]):
            lines[:] = (lines.astype(np.uint16) * 15 // 16).astype(np.uint8)
    return cells


def _font(pixels: int | float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=pixels * SUPERSAMPLE)


def _title(pen: ImageDraw.ImageDraw, layout: Layout, panel: int, title: str) -> None:
    top, left = layout.corner(panel)
    at = (left * SUPERSAMPLE, (top - 6) * SUPERSAMPLE)
    pen.text(at, title, fill=INK, font=_font(13), anchor="ls")


def _contacts(
    pen: ImageDraw.ImageDraw,
    layout: Layout,
    panel: int,
    contacts: Sequence[tuple[int, int]],
    places: Sequence[Point],
) -> None:
    width = max(2.0, layout.cell_pixels / 9)
    for pair in contacts:
        ends = [layout.centre(panel, places[robot]) for robot in pair]
        points = [(col * SUPERSAMPLE, row * SUPERSAMPLE) for row, col in ends]
        # White below the line keeps it visible on walls and on the map's black.
        for colour, pixels in ((PAGE, width + 2), (CONTACT, width)):
            pen.line(points, fill=colour, width=round(pixels * SUPERSAMPLE))


def _robots(pen: ImageDraw.ImageDraw, layout: Layout, panel: int, places: Sequence[Point]) -> None:
    disc = max(0.84 * layout.cell_pixels, SMALLEST_DISC)
    rim = max(1.0, disc / 16)
    font = _font(0.62 * disc)
    for robot, place in enumerate(places):
        row, col = (pixel * SUPERSAMPLE for pixel in layout.centre(panel, place))
        for colour, radius in ((PAGE, disc / 2), (robot_colour(robot), disc / 2 - rim)):
            reach = radius * SUPERSAMPLE
            pen.ellipse((col - reach, row - reach, col + reach, row + reach), fill=colour)
        pen.text((col, row), str(robot + 1), fill=PAGE, font=font, anchor="mm")


def _caption(pen: ImageDraw.ImageDraw, layout: Layout, scene: Scene) -> None:
    """The step on the left, the share cleaned as a bar and a number on the right."""
    top, left = layout.corner(0)
    left = min(left, MARGIN + (layout.width - 2 * MARGIN - CAPTION_WIDTH) // 2)
    middle = top + layout.rows * layout.cell_pixels + CAPTION // 2 + 2
    right = layout.width - left

    def box(start: int | float, end: int | float) -> tuple[int | float, ...]:
        return (
            start * SUPERSAMPLE, (middle - 4) * SUPERSAMPLE,
            end * SUPERSAMPLE, (middle + 4) * SUPERSAMPLE,
        )  # fmt: skip

    font = _font(13)
    pen.text((left * SUPERSAMPLE, middle * SUPERSAMPLE), f"step {scene.step}", INK, font, "lm")
    percent = f"{100 * scene.coverage:.1f} % clean"
    pen.text((right * SUPERSAMPLE, middle * SUPERSAMPLE), percent, INK, font, "rm")
    start, end = left + 84, right - 100
    pen.rounded_rectangle(box(start, end), 4 * SUPERSAMPLE, fill=FAINT)
    done = start + (end - start) * min(scene.coverage, 1.0)
    if done - start >= 8:  # a shorter bar has no room for its round ends
        pen.rounded_rectangle(box(start, done), 4 * SUPERSAMPLE, fill=ROBOTS[2])


def draw_text(scene: Scene, colour: bool = True) -> str:
    """The same step for a terminal, two characters a cell; without colour, for a file.

    In plain text `##` is wall, `%%` furniture, `..` dirt, `??` unknown, blank is clean.
    """
    house, known = house_colours(scene), map_colours(scene.values)
    house_marks = np.full(scene.free.shape, "##")
    house_marks[~scene.free & (scene.furniture > 0)] = "%%"
    house_marks[scene.free] = ".."
    house_marks[scene.free & scene.cleaned] = "  "
    map_marks = np.full(scene.free.shape, "  ")
    map_marks[scene.values <= 0] = ".."
    map_marks[scene.values < 0] = "??"
    map_marks[scene.values <= -1] = "##"
    robots = {place: robot for robot, place in enumerate(scene.positions)}

    def cell(colours: np.ndarray, marks: np.ndarray, place: Place) -> str:
        robot = robots.get(place)
        label = f"{robot + 1:>2}" if robot is not None else str(marks[place])
        if not colour:
            return label
        shade = robot_colour(robot) if robot is not None else tuple(int(c) for c in colours[place])
        return _ansi(label if robot is not None else "  ", shade)

    rows, cols = scene.free.shape
    title = f"{'house':<{2 * cols}}   {scene.map_title}"
    lines = [
        "".join(cell(house, house_marks, (row, col)) for col in range(cols))
        + "   "
        + "".join(cell(known, map_marks, (row, col)) for col in range(cols))
        for row in range(rows)
    ]
    pairs = " ".join(f"{first + 1}-{second + 1}" for first, second in scene.contacts) or "none"
    caption = f"step {scene.step}   {100 * scene.coverage:.1f} % clean   contact {pairs}"
    return "\n".join([title, *lines, caption])


def _ansi(label: str, background: tuple[int, ...]) -> str:
    red, green, blue = background
    return f"\x1b[1;97;48;2;{red};{green};{blue}m{label}\x1b[0m"
