"""Plans drawn in characters: what each means, and every way to draw a wrong one."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from marl_clean.errors import BadInput
from marl_clean.house.base import HouseLayout, draw_houses
from marl_clean.house.drawn import Drawn


def planned(folder: Path, text: str | bytes) -> HouseLayout:
    file = folder / "plan.txt"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return Drawn(str(file)).layout()


def test_each_character_has_its_meaning(tmp_path: Path) -> None:
    plan = planned(tmp_path, "#.a\n bb\n1S#\n..0\n")
    assert plan.free.tolist() == [
        [False, True, False],
        [True, False, False],
        [True, True, False],
        [True, True, True],
    ]
    assert plan.furniture.tolist() == [[0, 0, 1], [0, 2, 2], [0, 0, 0], [0, 0, 0]]
    assert plan.furniture.dtype == np.int16
    assert plan.starts == ((3, 2), (2, 0), (2, 1))
    assert plan.source == str(tmp_path / "plan.txt")


def test_windows_line_ends_and_blank_lines_at_the_end_change_nothing(tmp_path: Path) -> None:
    plain, windows = planned(tmp_path, "#.#\n..a"), planned(tmp_path, "#.#\r\n..a\r\n\r\n\n")
    np.testing.assert_array_equal(plain.free, windows.free)
    assert plain.starts is None


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.integers(1, 7), st.integers(1, 7), st.data())
def test_any_picture_reads_as_it_is_drawn(
    tmp_path_factory: pytest.TempPathFactory, rows: int, cols: int, data: st.DataObject
) -> None:
    line = st.text(alphabet="#. S", min_size=cols, max_size=cols)
    lines = data.draw(st.lists(line, min_size=rows, max_size=rows))
    plan = planned(tmp_path_factory.getbasetemp(), "\n".join(lines))
    assert plan.free.tolist() == [[cell != "#" for cell in line] for line in lines]
    starts = [(r, c) for r, line in enumerate(lines) for c, cell in enumerate(line) if cell == "S"]
    assert plan.starts == (tuple(starts) or None)


@pytest.mark.parametrize(
    "text, where",
    [
        ("", "line 1, column 1: empty"),
        ("\n\n", "line 1, column 1: empty"),
        ("\n...\n", "line 1, column 1: empty"),
        ("...\n..\n...", "line 2, column 3: the line has 2 characters, line 1 has 3"),
        ("...\n....", "line 2, column 4: the line has 4"),
        ("...\n\n...", "line 2, column 1: the line has 0"),
        ("...\n.\t.", r"line 2, column 2: '\\t'; valid: # wall"),
        ("..?", "line 1, column 3: '\\?'; valid"),
        ("...\n.\0.", "line 2, column 2"),
        ("..\n.é", "line 2, column 2: not an ASCII"),
        (b"..\n\xff.", "line 2, column 1: not an ASCII"),
        ("\ufeff..", "line 1, column 1: not an ASCII"),
        ("1.\n.1", "line 2, column 2: robot 1 a second time"),
        ("a..\n..a", "line 2, column 3: a second part of piece 'a'"),
        ("a.\n.a", "line 2, column 2: a second part"),
        ("." * 5000, "more than 4096"),
        (".\n" * 5000, "more than 4096"),
        (b"." * (16 * 2**20 + 1), "larger than 16,777,216 bytes"),
    ],
)
def test_a_wrong_drawing_is_named_by_file_line_and_column(
    tmp_path: Path, text: str | bytes, where: str
) -> None:
    with pytest.raises(BadInput, match=f"plan.txt.*{where}") as caught:
        planned(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_regions_and_starts_follow_the_rule_of_loaded_plans(tmp_path: Path) -> None:
    file = tmp_path / "plan.txt"
    for text, free_cells in (("....#...", 4), ("....#.S.", 3), ("...#...", 3)):
        file.write_text(text)
        assert draw_houses(Drawn(str(file)), [0], n_agents=2).free_cells.tolist() == [free_cells]
    file.write_text("1...#.2.")
    with pytest.raises(BadInput, match="two regions"):
        draw_houses(Drawn(str(file)), [0], n_agents=2)
    file.write_text("###\n#a#")
    with pytest.raises(BadInput, match="no free cell"):
        draw_houses(Drawn(str(file)), [0], n_agents=2)


def test_a_missing_file_is_met_with_what_would_be_valid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kitchen.txt").write_text("...")
    assert Drawn("kitchen.txt").layout().free.shape == (1, 3)
    for path, valid in (
        ("kitchn.txt", "did you mean 'kitchen.txt'"),
        ("apartmnt", "did you mean 'apartment'"),
        ("nowhere/at/all.txt", "shipped plan: apartment"),
        ("x" * 5000, "shipped plan"),
        ("null\0byte", "shipped plan"),
        (".", "shipped plan"),
    ):
        with pytest.raises(BadInput, match=valid):
            Drawn(path).layout()
    (tmp_path / "kitchen.doc").write_text("...")
    with pytest.raises(BadInput, match="does not end on any of .txt"):
        Drawn("kitchen.doc").layout()


def test_the_shipped_apartment_is_a_home() -> None:
    houses = draw_houses(Drawn(), [0], n_agents=2)
    plan = Drawn("apartment").layout()
    np.testing.assert_array_equal(houses.free[0], plan.free)
    assert houses.free_cells[0] >= 150 and plan.furniture.max() >= 10
    assert houses.sources == ["apartment"]
    # Without furniture and doors (floor between two walls) its rooms fall apart.
    floor = plan.free | (plan.furniture > 0)
    beside = (~floor[1:-1, :-2] & ~floor[1:-1, 2:]) | (~floor[:-2, 1:-1] & ~floor[2:, 1:-1])
    assert ndimage.label(floor[1:-1, 1:-1] & ~beside)[1] >= 4
