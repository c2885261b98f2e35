"""Floor plan files and settings that cannot be used: each named in one line."""

import math
import tracemalloc
from pathlib import Path

import pytest
import yaml

from marl_clean.errors import BadInput
from marl_clean.house import _floorplan_readers
from marl_clean.house.drawn import Drawn
from marl_clean.house.floorplan import FloorPlan
from marl_clean.storage import safe_yaml
from tests.house.test_floorplan import saved


@pytest.mark.parametrize(
    "changed, reason",
    [
        ({"image": "gone.png"}, "image 'gone.png' is missing"),
        ({"image": "../plan.png"}, "outside"),
        ({"image": "/etc/hostname"}, "outside"),
        ({"image": '"a\\0b"'}, "not a file name"),
        ({"image": "[a]"}, "not a file name"),
        ({"image": ""}, "not a file name"),
        ({"image": '"\\ud800.pgm"'}, "not yaml"),
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
        ({"resolution": "1e308"}, "make over 1,000,000 x over 1,000,000 cells"),
        ({"resolution": None}, "resolution is missing"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"origin": "[0, 0, up]"}, "origin 'up' is not a number"),
        ({"negate": "2"}, "negate '2'; valid: 0, 1"),
        ({"free_thresh": "1.5"}, "free_thresh 1.5 is not between 0 and 1"),
        ({"occupied_thresh": "-1"}, "occupied_thresh"),
        ({"free_thresh": "0.7"}, "occupied_thresh 0.65 is below free_thresh 0.7"),
        ({"mode": "raw"}, "mode 'raw'; valid: trinary, scale"),
        ({"mode": "{a: b}"}, "mode"),
        ({"more": "&a [1]"}, "anchors"),
        ({"more": "*a"}, "anchors"),
        ({"more": "1\nmore: 2"}, "the key 'more' stands twice"),
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
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_half_a_surrogate_pair_is_no_name_for_a_reader_that_lets_it_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = saved(tmp_path, [[254, 254]], image='"\\ud800.pgm"')
    monkeypatch.setattr(safe_yaml, "BASE", yaml.BaseLoader)  # as without libyaml
    monkeypatch.setattr(_floorplan_readers, "BASE", yaml.BaseLoader)
    with pytest.raises(BadInput, match="plan.yaml: image .* is not a file name") as caught:
        plan.layout()
    assert str(caught.value).isprintable()


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


@pytest.mark.parametrize("suffix", [".map", ".txt"])
def test_millions_of_lines_are_refused_before_they_are_split(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"plan{suffix}"
    path.write_bytes(b"\n" * (16 * 2**20 - 1) + b".")
    house = Drawn(str(path)) if suffix == ".txt" else FloorPlan(str(path))
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match="more than 4096 rows"):
            house.layout()
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20  # the file and a copy
    finally:
        tracemalloc.stop()


def test_a_path_and_lengths_are_asked_for() -> None:
    with pytest.raises(BadInput, match="house.path: null; valid: apartment"):
        FloorPlan(None)
    with pytest.raises(BadInput, match="house.cell_metres"):
        FloorPlan("apartment", cell_metres=0.0)
    with pytest.raises(BadInput, match="house.pixel_metres"):
        FloorPlan("apartment", pixel_metres=math.inf)
    with pytest.raises(BadInput, match="house.free_colours: apartment is no plain image"):
        FloorPlan("apartment", free_colours=[[1, 2, 3]]).layout()
    with pytest.raises(BadInput, match="did you mean 'apartment'"):
        FloorPlan("apartmen").layout()
