"""What became of a floor plan: region kept, regions left out, cells on the edge, unknown cells."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from marl_clean.house.base import HouseLayout
from marl_clean.house.drawn import Drawn
from marl_clean.house.floorplan import FloorPlan
from tests.house.test_floorplan import saved


def layout_of(text: str, **more: object) -> HouseLayout:
    free = np.array([[cell == "." for cell in line] for line in text.split()])
    return HouseLayout(free, np.zeros(free.shape, np.int16), None, "a plan", **more)


def test_the_line_names_size_free_cells_regions_left_out_and_edge() -> None:
    layout = layout_of("#####.# #...#.# #...### .####.. ....###", cell_metres=0.4)
    assert layout.regions().describe(layout.cell_metres) == (
        "5 x 7 cells of 0.4 m, 6 free in one region, 9 free cells in 3 other regions left out"
    )


def test_what_there_is_none_of_is_not_named() -> None:
    assert layout_of("..# ..#").regions().describe(None) == (
        "2 x 3 cells, 4 free in one region, 4 of the region on the edge of the plan"
    )
    assert layout_of("#### #..# #### #.##").regions().describe(0.25) == (
        "4 x 4 cells of 0.25 m, 2 free in one region, 1 free cell in 1 other region left out"
    )


@pytest.mark.parametrize("rows, cols", [(1, 1), (1, 5), (2, 3), (3, 2), (3, 3), (7, 3)])
def test_the_edge_is_the_outermost_cells(rows: int, cols: int) -> None:
    regions = layout_of(" ".join(["." * cols] * rows)).regions()
    inner = max(rows - 2, 0) * max(cols - 2, 0)
    assert regions.edge_cells == rows * cols - inner


def test_the_starts_region_is_kept_and_the_larger_one_left_out() -> None:
    path = str(Path(__file__).parents[2] / "marl_clean" / "house" / "plans" / "apartment.yaml")
    whole = FloorPlan(path, starts=[[1, 5]]).layout().regions()
    assert whole.num_left_out == 0 and not whole.left_out.any()
    np.testing.assert_array_equal(whole.kept, Drawn("apartment").layout().free)


def test_a_scan_tells_walls_from_what_it_did_not_see(tmp_path: Path) -> None:
    free, unknown, wall = 254, 205, 0
    pixels = [[unknown, unknown, wall, wall, free, free], [unknown] * 2 + [unknown, wall] * 2]
    layout = saved(tmp_path, pixels, resolution="0.2").layout()
    assert layout.unknown.tolist() == [[True, False, False]] and not layout.free.any()
    assert layout.cell_metres == 0.4


def test_what_is_see_through_in_a_plain_image_is_unknown(tmp_path: Path) -> None:
    white, black, clear = [255] * 4, [0, 0, 0, 255], [0] * 4
    pixels = np.array([[white, black, clear, clear], [white, black, clear, white]], dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "plan.png")
    layout = FloorPlan(str(tmp_path / "plan.png")).layout()
    assert layout.unknown.astype(int).tolist() == [[0, 0, 1, 1], [0, 0, 1, 0]]
    assert layout.cell_metres is None
    cut = FloorPlan(str(tmp_path / "plan.png"), pixel_metres=0.2).layout()
    assert cut.unknown.tolist() == [[False, False]] and cut.cell_metres == 0.4
