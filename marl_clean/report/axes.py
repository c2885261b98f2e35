"""Houses and maps on Matplotlib axes, as vectors, in the viewer's colours."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.env.viewer import INK, PAGE, ROBOTS, Colour, Place, robot_colour
from marl_clean.report.origin import Origin

STYLE: Any = {  # Matplotlib types its keys by a list of all of them
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "marl-clean",  # the same figure gives the same file
}

# Lines of one figure differ in these too: in grey, colours of one lightness are one.
LINES: tuple[Any, ...] = (
    "-", "--", "-.", ":",
    (0, (7, 3)), (0, (3, 1, 1, 1, 1, 1)), (0, (1, 4)), (0, (7, 2, 1, 2, 1, 2)),
)  # fmt: skip
LEGEND_LINE = 4  # font sizes: long enough to show the dashes
MARKS = "os^Dv<>P"
MOST_SQUARES = 20_000  # cells drawn one by one; more are an image in the figure


def new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches, laid out by itself and never shown on a screen."""
    return Figure(figsize=(width, height), layout="constrained")


def draw_cells(axes: Axes, colours: UInt8[np.ndarray, "row col 3"]) -> None:
    """One colour per cell, row 0 on top, cells square."""
    rows, cols, _ = colours.shape
    if rows * cols > MOST_SQUARES:
        axes.imshow(colours, extent=(0, cols, rows, 0), interpolation="antialiased")
    else:
        corners = np.arange(cols + 1), np.arange(rows + 1)
        axes.pcolormesh(*corners, colours / 255, edgecolors="face", linewidth=0.2)
    axes.set(xlim=(0, cols), ylim=(rows, 0), aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(visible=True, color=unit(INK), linewidth=0.8)


def draw_robots(axes: Axes, positions: Sequence[Place], first: int = 0) -> None:
    """Numbered discs, as in every other picture; `first` is the index of the first robot."""
    for robot, (row, col) in enumerate(positions, start=first):
        axes.add_patch(
            matplotlib.patches.Circle(
                (col + 0.5, row + 0.5), 0.42, facecolor=unit(robot_colour(robot)), zorder=3
            )
        )
        axes.text(
            col + 0.5, row + 0.53, str(robot + 1),
            color=unit(PAGE), fontsize=6.5, ha="center", va="center_baseline", zorder=4,
        )  # fmt: skip


def unit(colour: Colour) -> tuple[float, float, float]:
    """A colour as Matplotlib wants it."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def row_style(index: int) -> dict[str, Any]:
    """The colour and dashes of a row's line; those of the ninth row are the first's again."""
    return {"color": row_colour(index), "linestyle": LINES[index % len(LINES)]}


def row_colour(index: int) -> tuple[float, float, float]:
    """A row's colour."""
    return unit(ROBOTS[index % len(ROBOTS)])


def row_mark(index: int) -> str:
    """A row's mark, by which its points differ from those of other rows in grey too."""
    return MARKS[index % len(MARKS)]


def seeds_label(name: str, seeds: int) -> str:
    """A row's name with its number of seeds; a planner has none."""
    return name if seeds == 0 else f"{name} ({seeds} seed{'s' if seeds > 1 else ''})"


def save_figure(figure: Figure, stem: Path, origin: Origin) -> list[Path]:
    """Write `stem`.svg and `stem`.png; the same figure and origin give the same bytes."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("svg", "png")]
    with matplotlib.rc_context(STYLE):
        undated = {"Date": None, **origin.metadata()}
        figure.savefig(paths[0], dpi=200, metadata=undated)  # dpi of images in it alone
        figure.savefig(paths[1], dpi=200, metadata=origin.metadata())
    return paths


def legend_below(figure: Figure, side: Literal["center", "right"]) -> None:
    """Put one legend of all panels under them."""
    named = {
        label: handle
        for axes in figure.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    place: Any = f"outside lower {side}"  # Matplotlib types it by a list of all of them
    figure.legend(
        list(named.values()), list(named), loc=place, frameon=False, fontsize=7, ncols=len(named)
    )
