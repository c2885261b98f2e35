"""Floor plan files: real ones by their cell counts, the reading rules by hand."""

import logging
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from marl_clean.errors import BadInput
from marl_clean.house._floorplan_readers import to_cells
from marl_clean.house.base import draw_houses
from marl_clean.house.drawn import SHIPPED, Drawn
from marl_clean.house.floorplan import FloorPlan

SETTINGS = {
    "image": "plan.png",
    "resolution": "0.4",
    "origin": "[0, 0, 0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def saved(folder: Path, pixels: object, **changed: str | None) -> FloorPlan:
    """A map_server plan of these pixels; a setting that is None is left out."""
    Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / "plan.png")
    lines = [f"{key}: {value}" for key, value in (SETTINGS | changed).items() if value is not None]
    (folder / "plan.yaml").write_text("\n".join(lines))
    return FloorPlan(str(folder / "plan.yaml"))


def free_of(plan: FloorPlan) -> list[list[int]]:
    return plan.layout().free.astype(int).tolist()


@pytest.mark.parametrize(
    "name, free_cells",
    [
        ("ros/aws_small_house.yaml", 2233),
        ("ros/turtlebot3_world.yaml", 265),
        ("movingai/room-32-32-4.map", 682),
        ("movingai/random-32-32-20.map", 819),
        ("movingai/maze-32-32-4.map", 790),
        ("movingai/room-64-64-16.map", 3646),
        ("movingai/empty-16-16.map", 256),
    ],
)
def test_real_plans_have_their_known_number_of_cells(
    maps: Path, name: str, free_cells: int
) -> None:
    houses = draw_houses(FloorPlan(str(maps / name), cell_metres=0.25), [0], n_agents=2)
    assert houses.free_cells.tolist() == [free_cells]


@pytest.mark.slow
def test_every_real_plan_loads(maps: Path) -> None:
    files = [file for file in maps.glob("*/*") if file.suffix in (".yaml", ".pgm", ".png")]
    assert len(files) == 14
    for file in files:
        houses = draw_houses(FloorPlan(str(file), cell_metres=0.1), [0], n_agents=2)
        assert houses.free_cells[0] > 2 and houses.sources == [str(file)]


def test_the_apartment_as_files_is_the_apartment_as_drawn() -> None:
    drawn = Drawn("apartment").layout().free
    for path in ("apartment", str(SHIPPED / "apartment.yaml")):
        np.testing.assert_array_equal(FloorPlan(path).layout().free, drawn)
    scanned = np.asarray(Image.open(SHIPPED / "apartment.pgm"))
    np.testing.assert_array_equal(scanned, np.kron(drawn, np.ones((4, 4))) * 254)
    plain = FloorPlan(str(SHIPPED / "apartment.pgm"), cell_metres=0.8, pixel_metres=0.2)
    np.testing.assert_array_equal(plain.layout().free, drawn)


def slow_cells(
    free: np.ndarray, occupied: np.ndarray, pixel: Fraction, cell: Fraction
) -> np.ndarray:
    """The same as `to_cells`, one cell and one pixel at a time, counted from the lower left."""
    half = Fraction(1, 2)
    rows, cols = (math.floor(side * pixel / cell) for side in free.shape)
    cells = np.zeros((rows, cols), dtype=bool)
    holders = [[(each + half) * pixel // cell for each in range(side)] for side in free.shape]
    for row, col in np.ndindex(rows, cols):
        if cell < pixel:
            inside = [((row + half) * cell // pixel, (col + half) * cell // pixel)]
        else:
            ups = [up for up, holder in enumerate(holders[0]) if holder == row]
            rights = [right for right, holder in enumerate(holders[1]) if holder == col]
            inside = [(up, right) for up in ups for right in rights]
        places = [(free.shape[0] - 1 - up, right) for up, right in inside]
        num_free = sum(bool(free[place]) for place in places)
        blocked = any(occupied[place] for place in places)
        cells[rows - 1 - row, col] = 2 * num_free >= len(places) and not blocked
    return cells


@pytest.mark.parametrize("pixel", range(1, 13))
def test_cells_are_cut_as_the_rule_says(pixel: int) -> None:
    numbers = np.random.default_rng(pixel)
    for cell in range(1, 31):
        grid = numbers.integers(0, 8, size=(11, 7))
        free, occupied = grid > 2, grid == 0  # 1 and 2 are unknown
        expected = slow_cells(free, occupied, Fraction(pixel, 20), Fraction(cell, 20))
        if expected.size == 0:
            with pytest.raises(BadInput, match="house.cell_metres"):
                to_cells(Path("plan"), free, occupied, pixel / 20, cell / 20)
        else:
            cells = to_cells(Path("plan"), free, occupied, pixel / 20, cell / 20)
            np.testing.assert_array_equal(cells, expected)


def test_cells_hang_at_the_lower_left_corner(tmp_path: Path) -> None:
    pixels = np.full((5, 5), 254)
    pixels[0, :], pixels[:, 4], pixels[4, 0] = 0, 0, 0
    assert free_of(saved(tmp_path, pixels, resolution="0.2")) == [[1, 1], [0, 1]]


def test_half_of_the_pixels_and_none_occupied(tmp_path: Path) -> None:
    unknown, occupied, free = 205, 0, 254
    pixels = [
        [free, unknown, free, unknown, free, free],
        [free, unknown, unknown, unknown, free, occupied],
    ]
    assert free_of(saved(tmp_path, pixels, resolution="0.2")) == [[1, 0, 0]]


def test_grey_205_is_free_or_unknown_by_the_threshold(tmp_path: Path) -> None:
    assert free_of(saved(tmp_path, [[205, 254]])) == [[0, 1]]
    assert free_of(saved(tmp_path, [[205, 254]], free_thresh="0.25")) == [[1, 1]]


def test_negate_and_thresholds_that_pixels_meet_exactly(tmp_path: Path) -> None:
    pixels = [[0, 51, 52, 204, 255]]
    assert free_of(saved(tmp_path, pixels, negate="1", free_thresh="0.2")) == [[1, 1, 0, 0, 0]]
    assert free_of(saved(tmp_path, pixels, negate="0", free_thresh="0.2")) == [[0, 0, 0, 1, 1]]
    both = {"free_thresh": "0.8", "occupied_thresh": "0.8"}
    assert free_of(saved(tmp_path, pixels, **both)) == [[0, 0, 1, 1, 1]]


def test_colours_count_by_their_mean_and_see_through_is_unknown(tmp_path: Path) -> None:
    colour = [[[255, 255, 255], [255, 255, 0], [255, 204, 204], [0, 0, 0]]]
    assert free_of(saved(tmp_path, colour)) == [[1, 0, 1, 0]]
    clear = [[[255, 255, 255, 255], [255, 255, 255, 254], [0, 0, 0, 0], [0, 0, 0, 255]]]
    # Four pixels a cell: one see-through black pixel is unknown, so it blocks no cell.
    assert free_of(saved(tmp_path, clear)) == [[1, 0, 0, 0]]
    square = np.array([[[255] * 4, [255] * 4], [[255] * 4, [0] * 4]])
    assert free_of(saved(tmp_path, square, resolution="0.2")) == [[1]]


def test_16_bits_and_comments_in_the_header(tmp_path: Path) -> None:
    values = np.array([0, 65535, 50_000, 65_000], dtype=">u2").tobytes()
    (tmp_path / "deep.pgm").write_bytes(b"P5\n# a # comment\n4 # wide\n1\n65535\n" + values)
    plan = saved(tmp_path, [[0]], image="deep.pgm")
    assert free_of(plan) == [[0, 1, 0, 1]]


@pytest.mark.parametrize("name", ["plan.png", "plan.bmp", "plan.pgm", "plan.ppm"])
def test_a_plain_image_is_free_from_grey_128_a_pixel_a_cell(tmp_path: Path, name: str) -> None:
    image = Image.fromarray(np.array([[127, 128], [0, 255]], dtype=np.uint8))
    (image.convert("RGB") if name.endswith("ppm") else image).save(tmp_path / name)
    assert free_of(FloorPlan(str(tmp_path / name))) == [[0, 1], [0, 1]]


def test_yaw_is_ignored_with_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        saved(tmp_path, [[254]], origin="[1, 2, 0]").layout()
        assert not caplog.messages
        saved(tmp_path, [[254]], origin="[1, 2, 0.5]").layout()
        saved(tmp_path, [[254]], origin="[1, 2, 0.5]").layout()
    assert len(caplog.messages) == 1 and "yaw of 0.5 is ignored" in caplog.messages[0]


def test_given_starts_choose_the_region() -> None:
    path = str(SHIPPED / "apartment.yaml")
    houses = draw_houses(FloorPlan(path, starts=[[1, 5], [8, 8]]), [0], n_agents=2)
    assert houses.starts.tolist() == [[[1, 5], [8, 8]]]
    for start in ([0, 0], [1, -1], [99, 0], [1], [1, 2, 3]):
        with pytest.raises(BadInput, match="house.starts"):
            FloorPlan(path, starts=[start]).layout()
    with pytest.raises(BadInput, match="given twice"):
        FloorPlan(path, starts=[[1, 5], [1, 5]]).layout()


def test_movingai_characters(tmp_path: Path) -> None:
    file = tmp_path / "plan.map"
    file.write_bytes(b"type octile\r\nheight 2\r\nwidth 4\r\nmap\r\n.GS@\r\nOTW.\r\n\r\n")
    assert free_of(FloorPlan(str(file))) == [[1, 1, 1, 0], [0, 0, 0, 1]]


def test_the_home_folder_may_be_written_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path, [[254, 0]])
    monkeypatch.setenv("HOME", str(tmp_path))
    layout = FloorPlan("~/plan.yaml").layout()
    assert layout.free.tolist() == [[True, False]] and layout.source == "~/plan.yaml"
    with pytest.raises(BadInput, match="no file '~nobody-of-this-name/plan.yaml'"):
        FloorPlan("~nobody-of-this-name/plan.yaml").layout()
