"""A floor plan as one figure: the region kept, the regions left out, what is blocked."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from marl_clean.env.viewer import DIRTY, FURNITURE, INK, UNKNOWN, WALL, Colour
from marl_clean.house.base import HouseLayout
from marl_clean.report.axes import draw_cells, new_figure, unit

LEFT_OUT: Colour = (152, 54, 116)  # between wall and furniture in lightness
PAGE_WIDTH, PAGE_HEIGHT, SMALLEST_SIDE = 11.0, 8.0, 4.0  # inches of the drawing itself
AROUND = 0.9  # inches for title and legend
CHARACTER = 0.085  # inches per character of a title, so that it fits above a narrow floor plan


def draw_floor_plan(layout: HouseLayout) -> Figure:
    """The floor plan as large as the page allows, titled with the file's name and cell counts."""
    rows, cols = layout.free.shape
    line = layout.regions().describe(layout.cell_metres)
    scale = min(PAGE_WIDTH / cols, PAGE_HEIGHT / rows)
    width = max(cols * scale, SMALLEST_SIDE, CHARACTER * len(line))
    figure = new_figure(width, max(rows * scale, SMALLEST_SIDE / 2) + AROUND)
    axes = figure.subplots()
    draw_cells(axes, floor_plan_colours(layout))
    axes.set_title(f"{Path(str(layout.source)).name}\n{line}")
    handles = [
        Patch(facecolor=unit(colour), edgecolor=unit(INK), linewidth=0.5, label=label)
        for label, colour in legend_of(layout).items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def floor_plan_colours(layout: HouseLayout) -> UInt8[np.ndarray, "row col 3"]:
    """One colour per cell."""
    regions = layout.regions()
    colours = np.empty((*layout.free.shape, 3), dtype=np.uint8)
    colours[:] = WALL
    if layout.unknown is not None:
        colours[layout.unknown] = UNKNOWN
    colours[layout.furniture > 0] = FURNITURE
    colours[regions.left_out] = LEFT_OUT
    colours[regions.kept] = DIRTY
    return colours


def legend_of(layout: HouseLayout) -> dict[str, Colour]:
    """The meaning of each colour that the floor plan has."""
    regions = layout.regions()
    unknown = layout.unknown if layout.unknown is not None else np.zeros_like(layout.free)
    furniture = layout.furniture > 0
    left_out = "1 region" if regions.num_left_out == 1 else f"{regions.num_left_out:,} regions"
    entries = (
        ("kept: the house", DIRTY, True),
        (f"left out: {left_out}", LEFT_OUT, regions.num_left_out > 0),
        ("furniture", FURNITURE, furniture.any()),
        ("wall", WALL, not (layout.free | unknown | furniture).all()),
        ("unknown", UNKNOWN, unknown.any()),
    )
    return {label: colour for label, colour, is_there in entries if is_there}
