"""Floor plan files: real ones by their cell counts, the reading rules by hand, wrong ones named."""

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
    both = {"free_thresh": "1", "occupied_thresh": "0.8"}
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


@pytest.mark.parametrize(
    "changed, reason",
    [
        ({"image": "gone.png"}, "image 'gone.png' is missing"),
        ({"image": "../plan.png"}, "outside"),
        ({"image": "/etc/hostname"}, "outside"),
        ({"image": '"a\\0b"'}, "not a file name"),
        ({"image": "[a]"}, "not a file name"),
        ({"image": ""}, "not a file name"),
        ({"image": "x" * 300}, "missing"),
        ({"image": "plan.yaml"}, "not an image"),
        ({"image": None}, "image is missing"),
        ({"resolution": "0"}, "above 0"),
        ({"resolution": "-0.05"}, "above 0"),
        ({"resolution": ".nan"}, "resolution '.nan' is not a number"),
        ({"resolution": "five"}, "resolution 'five' is not a number"),
        ({"resolution": "[1]"}, "not a number"),
        ({"resolution": "1e300"}, "house.cell_metres"),
        ({"resolution": "1e-300"}, "house.cell_metres"),
        ({"resolution": None}, "resolution is missing"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"origin": "[0, 0, up]"}, "origin 'up' is not a number"),
        ({"negate": "2"}, "negate '2'; valid: 0, 1"),
        ({"free_thresh": "1.5"}, "free_thresh 1.5 is not between 0 and 1"),
        ({"occupied_thresh": "-1"}, "occupied_thresh"),
        ({"mode": "raw"}, "mode 'raw'; valid: trinary, scale"),
        ({"mode": "{a: b}"}, "mode"),
        ({"more": "&a [1]"}, "anchors"),
        ({"more": "*a"}, "anchors"),
        ({"more": "[[[[[[1]]]]]]"}, "nested"),
        ({"more": "[" * 5000}, "nested|not yaml"),
        ({"more": "- " * 5000}, "nested|not yaml"),
        ({"more": "[1"}, "not yaml"),
        ({"more": "a" * 20_000}, "larger than 16,384 bytes"),
        ({"more": '"\x07"'}, "not yaml"),
    ],
)
def test_a_wrong_yaml_is_named_in_one_line(
    tmp_path: Path, changed: dict[str, str | None], reason: str
) -> None:
    plan = saved(tmp_path, [[254, 254]], **changed)
    with pytest.raises(BadInput, match=f"plan.yaml: .*({reason})") as caught:
        plan.layout()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1", "hello", "\xff", "a: 1\n---\nb: 2"])
def test_a_yaml_of_something_else_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.yaml").write_text(text, encoding="latin-1")
    with pytest.raises(BadInput, match="plan.yaml: "):
        FloorPlan(str(tmp_path / "plan.yaml")).layout()


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    saved(tmp_path, [[254, 254]])
    plan = saved(inside, [[254, 254]], image="link.png")
    (inside / "link.png").symlink_to(tmp_path / "plan.png")
    with pytest.raises(BadInput, match="outside"):
        plan.layout()


@pytest.mark.parametrize(
    "name, content, reason",
    [
        ("plan.pgm", b"P5\n4097 1\n255\n", "1 x 4097 pixels"),
        ("plan.pgm", b"P5\n99999 99999\n255\n", "at most 4096"),
        ("plan.pgm", b"P5\n15000 10000\n255\n", "at most 4096"),
        ("plan.pgm", b"P5\n4 4\n255\nab", "damaged"),
        ("plan.pgm", b"P5\n4 x\n255\nab", "damaged"),
        ("plan.png", b"", "not an image"),
        ("plan.png", b"\x89PNG\r\n\x1a\n", "not an image"),
        ("plan.png", b"GIF89a", "not an image"),
        ("plan.pgm", b"Pf\n1 1\n-1.0\n" + bytes(4), "not an image"),
        ("plan.map", b"", "not MovingAI"),
        ("plan.map", b"type octile\nheight 1\nmap\n.", "not MovingAI"),
        ("plan.map", b"type octile\nheight 0\nwidth 1\nmap\n", "line 2: height must be 1 to 4096"),
        ("plan.map", b"type octile\nheight 1\nwidth -1\nmap\n.", "line 3: width must be"),
        ("plan.map", b"type octile\nheight 1 1\nwidth 1\nmap\n.", "line 2: height must be"),
        ("plan.map", b"type octile\nheight 2\nwidth 1\nmap\n.", "height 2, but 1 rows"),
        ("plan.map", b"type octile\nheight 1\nwidth 1\nmap\n.\n.", "height 1, but 2 rows"),
        ("plan.map", b"type octile\nheight 1\nwidth 2\nmap\n.", "line 5: 1 characters"),
        ("plan.map", b"type octile\nheight 1\nwidth 2\nmap\n.x", "line 5, column 2: 'x'"),
        (
            "plan.map",
            b"type octile\nheight 1\nwidth 1\nmap\n\xe9",
            "line 5, column 1: not an ASCII",
        ),
        ("plan.map", b"type octile\nheight " + b"9" * 5000, "not MovingAI"),
        ("plan.gif", b"GIF89a", "does not end on any of .yaml"),
    ],
)
def test_other_wrong_files_are_named_in_one_line(
    tmp_path: Path, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=f"{name}.*{reason}") as caught:
        FloorPlan(str(tmp_path / name)).layout()
    assert "\n" not in str(caught.value)


def test_movingai_characters(tmp_path: Path) -> None:
    file = tmp_path / "plan.map"
    file.write_bytes(b"type octile\r\nheight 2\r\nwidth 4\r\nmap\r\n.GS@\r\nOTW.\r\n\r\n")
    assert free_of(FloorPlan(str(file))) == [[1, 1, 1, 0], [0, 0, 0, 1]]


def test_a_path_and_lengths_are_asked_for() -> None:
    with pytest.raises(BadInput, match="house.path: null; valid: apartment"):
        FloorPlan(None)
    with pytest.raises(BadInput, match="house.cell_metres"):
        FloorPlan("apartment", cell_metres=0.0)
    with pytest.raises(BadInput, match="house.pixel_metres"):
        FloorPlan("apartment", pixel_metres=math.inf)
    with pytest.raises(BadInput, match="did you mean 'apartment'"):
        FloorPlan("apartmen").layout()
