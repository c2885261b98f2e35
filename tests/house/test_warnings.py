"""Plans that are read as their rule says, and yet not as their owner meant: one warning each."""

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.floorplan import FloorPlan
from tests.house.test_floorplan import free_of, saved

OUTSIDE, FLOOR, WALL = [19, 87, 148], [32, 115, 185], [100, 196, 254]  # of a vacuum app
RING = [[205] * 7, [205, *[0] * 5, 205], *[[205, 0, 205, 205, 205, 0, 205]] * 5]
RING += [[205, *[0] * 5, 205], [205] * 7]


@pytest.fixture
def vacuum_map(tmp_path: Path) -> str:
    """A room of 2 x 3 cells in its walls, with the outside around it."""
    room = [OUTSIDE, WALL, FLOOR, FLOOR, FLOOR, WALL, OUTSIDE]
    across = [OUTSIDE, *[WALL] * 5, OUTSIDE]
    pixels = np.array([[OUTSIDE] * 7, across, room, room, across, [OUTSIDE] * 7], dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "flat.png")
    return str(tmp_path / "flat.png")


def warnings_of(house: FloorPlan, caplog: pytest.LogCaptureFixture) -> list[str]:
    """What is said about a plan that a command reads several times."""
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            house.layout()
    return caplog.messages


def test_unknown_that_counts_as_free_is_one_warning_with_the_edge(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ring = saved(tmp_path, RING, free_thresh="0.25")
    (warning,) = warnings_of(ring, caplog)
    assert warning == (
        f"{ring.path}: free_thresh 0.25: grey 205 counts as free here, 0.196 would make it "
        "unknown; 28 of the region's 28 cells lie on the edge of the plan"
    )
    assert draw_houses(ring, [0], n_agents=2).free_cells.tolist() == [28]  # map_server's own rule


def test_the_ring_as_a_robot_saved_it(maps: Path, caplog: pytest.LogCaptureFixture) -> None:
    ring = FloorPlan(str(maps.parent / "cases" / "ring.yaml"))
    (warning,) = warnings_of(ring, caplog)
    assert "grey 205" in warning and "28 of the region's 28 cells" in warning
    layout = ring.layout()
    assert layout.regions().describe(layout.cell_metres) == (
        "7 x 9 cells of 0.4 m, 28 free in one region, 15 free cells in 1 other region left out, "
        "28 of the region on the edge of the plan"
    )


def test_no_warning_where_grey_205_is_unknown_or_not_there(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert warnings_of(saved(tmp_path, [[254, 205]], free_thresh="0.196"), caplog) == []
    assert warnings_of(saved(tmp_path, [[254, 206]], free_thresh="0.25"), caplog) == []


def test_a_coloured_map_is_warned_of_and_its_floor_can_be_named(
    vacuum_map: str, caplog: pytest.LogCaptureFixture
) -> None:
    (warning,) = warnings_of(FloorPlan(vacuum_map), caplog)
    assert warning.startswith(f"{vacuum_map}: most of it is coloured")
    assert "house.free_colours=" in warning
    named = FloorPlan(vacuum_map, free_colours=[FLOOR])
    assert warnings_of(named, caplog) == []
    expected = np.zeros((6, 7), dtype=int)
    expected[2:4, 2:5] = 1
    assert free_of(named) == expected.tolist()
    cut = FloorPlan(vacuum_map, cell_metres=0.2, pixel_metres=0.1, free_colours=[FLOOR])
    assert free_of(cut) == [[0, 0, 0], [0, 1, 0], [0, 0, 0]]


def test_colours_are_named_to_a_few_units_and_several_at_once(tmp_path: Path) -> None:
    pixels = np.array([[[8, 100, 250], [9, 100, 250], [200, 0, 0], [0, 0, 0]]], dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "plan.png")
    file = str(tmp_path / "plan.png")
    assert free_of(FloorPlan(file, free_colours=[[0, 100, 255]])) == [[1, 0, 0, 0]]
    both = [[0, 100, 250], [200, 0, 0]]
    assert free_of(FloorPlan(file, free_colours=both)) == [[1, 0, 1, 0]]
    assert free_of(FloorPlan(file, free_colours=[[0, 0, 0]])) == [[0, 0, 0, 1]]


def test_a_deep_grey_image_has_colours_too(tmp_path: Path) -> None:
    values = np.array([0, 65535, 32896], dtype=">u2").tobytes()
    (tmp_path / "deep.pgm").write_bytes(b"P5 3 1 65535\n" + values)
    file = str(tmp_path / "deep.pgm")
    assert free_of(FloorPlan(file, free_colours=[[128, 128, 128]])) == [[0, 0, 1]]


def test_most_counts_opaque_pixels_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    grey, blue, clear = [200, 210, 215, 255], [0, 0, 255, 255], [0, 0, 255, 0]
    for pixels, warnings in ([grey, blue, clear, clear], 0), ([grey, blue, blue, clear], 1):
        file = tmp_path / f"plan{warnings}.png"
        Image.fromarray(np.array([pixels], dtype=np.uint8)).save(file)
        assert len(warnings_of(FloorPlan(str(file)), caplog)) == warnings


def test_a_floor_without_the_colour_has_no_free_cell(vacuum_map: str) -> None:
    with pytest.raises(BadInput, match="flat.png: the floor plan has no free cell"):
        draw_houses(FloorPlan(vacuum_map, free_colours=[[1, 2, 3]]), [0], n_agents=1)
