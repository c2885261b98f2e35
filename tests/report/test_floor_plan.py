"""The figure of a floor plan: what is kept, left out, blocked and unknown, as large as the page."""

from pathlib import Path

import numpy as np
import pytest

from marl_clean.config.compose import compose_config
from marl_clean.env.viewer import DIRTY, FURNITURE, UNKNOWN, WALL
from marl_clean.house.base import HouseLayout
from marl_clean.report.axes import save_figure
from marl_clean.report.figures import draw_figure
from marl_clean.report.floor_plan import (
    LEFT_OUT,
    draw_floor_plan,
    floor_plan_colours,
    legend_of,
)
from marl_clean.report.origin import Origin


def layout_of(text: str, source: str = "maps/flat.yaml") -> HouseLayout:
    """`.` free, `#` wall, `?` unknown, `a` furniture."""
    cells = np.array([list(line) for line in text.split()])
    return HouseLayout(
        free=cells == ".",
        furniture=(cells == "a").astype(np.int16),
        starts=None,
        source=source,
        unknown=cells == "?",
    )


def test_every_kind_of_cell_has_its_colour() -> None:
    layout = layout_of("??##### ?#..a#. ..#.##.")
    kinds = {".": DIRTY, "x": LEFT_OUT, "#": WALL, "?": UNKNOWN, "a": FURNITURE}
    expected = [list(line) for line in ("??#####", "?#..a#x", "xx#.##x")]
    colours = floor_plan_colours(layout)
    assert colours.shape == (3, 7, 3)
    assert [[tuple(cell) for cell in row] for row in colours.tolist()] == [
        [kinds[cell] for cell in row] for row in expected
    ]


def test_the_legend_names_what_is_there_and_nothing_else() -> None:
    assert legend_of(layout_of("...")) == {"kept: the house": DIRTY}
    assert list(legend_of(layout_of("..#. a?#."))) == [
        "kept: the house",
        "left out: 1 region",
        "furniture",
        "wall",
        "unknown",
    ]
    assert "left out: 2 regions" in legend_of(layout_of("..#.?."))


@pytest.mark.parametrize("rows, cols", [(3, 4), (30, 7), (7, 30), (200, 150)])
def test_a_plan_fills_its_page_and_has_the_files_name(rows: int, cols: int) -> None:
    figure = draw_floor_plan(layout_of(" ".join(["." * cols] * rows)))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    width, height = figure.get_size_inches()
    box = axes.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
    assert box.width > 0.9 * width or box.height > 0.8 * height
    assert width <= 11.0 and height <= 9.0
    assert axes.get_title().splitlines()[0] == "flat.yaml"
    assert f"{rows} x {cols} cells" in axes.get_title()


def test_a_title_longer_than_a_narrow_plan_is_wide_has_room() -> None:
    figure = draw_floor_plan(layout_of(" ".join([".#."] * 30)))
    figure.draw_without_rendering()
    title = figure.axes[0].title.get_window_extent()
    assert title.x0 >= 0 and title.x1 <= figure.bbox.x1


@pytest.mark.slow
def test_a_large_plan_is_an_image_and_not_a_square_for_each_cell(tmp_path: Path) -> None:
    layout = layout_of(" ".join([".#" * 200] * 200))
    svg, png = save_figure(draw_floor_plan(layout), tmp_path / "plan", Origin("", []))
    assert svg.stat().st_size < 1_000_000 and png.stat().st_size < 1_000_000


@pytest.mark.slow
def test_figure_houses_of_one_plan_is_that_plan_and_of_many_a_sheet() -> None:
    figure = draw_figure("houses", compose_config(["house=floorplan", "house.path=apartment"]))
    (axes,) = figure.axes
    assert axes.get_title().startswith("apartment\n")
    assert len(draw_figure("houses", compose_config(["house=open"])).axes) == 32
