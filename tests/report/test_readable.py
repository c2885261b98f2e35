"""Figures name the command and configs behind them, and can be read in grey and below legends."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from marl_clean.commands.command_line import command_line, issued
from marl_clean.env import viewer
from marl_clean.evaluation.paired import Row
from marl_clean.evaluation.records import MEASURES, Entry, make_entry
from marl_clean.evaluation.row_statistics import row_statistics
from marl_clean.report import figures, floor_plan
from marl_clean.report.axes import LINES, MARKS, save_figure
from marl_clean.report.comparison import draw_comparison
from marl_clean.report.curve import plot_curve
from marl_clean.report.origin import Origin
from marl_clean.report.profiles import draw_profiles
from tests.report.reading import (
    LIGHTNESSES_APART,
    alike_in_grey,
    covered_by_legends,
    lightness,
    origin_of,
)

ROWS = 6
ORIGIN = Origin("marl-clean figure paper_1 'house.path=my home.txt'", ["ab" * 32, "cd" * 32])


def entry(name: str, first: int) -> Entry:
    """A policy that takes `first` steps and more in four houses."""
    record = {measure: 1.0 for measure in MEASURES if not measure.endswith("certify")}
    record |= {f"bound_{name}": 10 for name in ("90", "95", "99", "100")}
    record |= {"rows": 10, "cols": 10, "free_cells": 48, "max_steps": 250}
    houses = [
        record | {"seed": seed, "T_90": first + 5 * seed, "T_100": first + 9 * seed, "bits": first}
        for seed in range(4)
    ]
    return make_entry(name, "test", "ab" * 32, 0.0, 2, houses)


def learning_curve() -> Figure:
    """A curve whose lines reach every corner, as those of coverage do."""
    frames = np.linspace(0, 1000, 30)
    columns = {
        name: [(float(f), float(value)) for f, value in zip(frames, values, strict=True)]
        for name, values in {
            "coverage": frames / 1000,
            "validation/coverage": 1 - frames / 1000,
            "validation/T_90": np.where(frames % 200 < 100, 90.0, 40.0),
        }.items()
    }
    return plot_curve(columns, {"coverage": 0.99, "T_90": 47.0})


def comparison() -> Figure:
    return draw_comparison("q", {f"row {i}": (entry("a", 40 + i), entry("b", 50)) for i in (1, 2)})


def profiles() -> Figure:
    entries = [entry(f"row {i}", 40 + 10 * i) for i in range(ROWS)]
    return draw_profiles("q", row_statistics([Row(e["policy"], {0: e}) for e in entries], None))


FIGURES = {
    "curve": learning_curve,
    "comparison": comparison,
    "profiles": profiles,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_no_legend_lies_over_a_line_and_grey_keeps_rows_apart(name: str) -> None:
    figure = FIGURES[name]()
    assert covered_by_legends(figure) == []
    assert alike_in_grey(figure) == []


def test_a_covered_line_and_lines_alike_in_grey_are_seen() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#0072b2", label="a")
    axes.plot([0, 1], [1, 0], color="#b24c84", label="b")
    axes.plot([0, 1], [0, 0], color="#b24c84", label="c", linestyle="--")
    axes.legend(loc="upper right")
    assert covered_by_legends(figure) == ["a"]
    assert alike_in_grey(figure) == [("a", "b")]


def test_no_two_rows_in_eight_have_the_same_dashes_or_mark() -> None:
    assert len(set(LINES)) == len(LINES) == len(set(MARKS)) == len(viewer.ROBOTS)


@pytest.mark.parametrize(
    "together",
    [
        (viewer.WALL, viewer.FURNITURE, viewer.UNKNOWN, viewer.DIRTY, floor_plan.LEFT_OUT),
        (viewer.BLOCKED, figures.PAPER_UNKNOWN, figures.PAPER_VISITED),
    ],
    ids=["floor plan", "memory"],
)
def test_cells_of_one_picture_differ_in_lightness(together: tuple[viewer.Colour, ...]) -> None:
    shades = [lightness([channel / 255 for channel in colour]) for colour in together]
    assert min(abs(a - b) for a, b in combinations(shades, 2)) >= LIGHTNESSES_APART


def test_lightness_is_that_of_the_cie() -> None:
    assert lightness("white") == pytest.approx(100) and lightness("black") == 0
    assert lightness("#777777") == pytest.approx(50, abs=0.5)
    assert lightness("#00ff00") == pytest.approx(87.7, abs=0.1)


@pytest.mark.slow
def test_both_files_name_the_command_and_the_configs(tmp_path: Path) -> None:
    files = save_figure(comparison(), tmp_path / "one", ORIGIN)
    for path in files:
        assert origin_of(path) == (ORIGIN.command, list(ORIGIN.config_hashes))
    again = save_figure(comparison(), tmp_path / "two", ORIGIN)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in files]


def test_a_config_of_several_seeds_and_houses_is_named_once() -> None:
    assert Origin("c", ["b", "a", "b"]).metadata()["Identifier"] == "config sha256 b a"


def test_the_command_can_be_given_again(monkeypatch: pytest.MonkeyPatch) -> None:
    with issued(["figure", "houses", "house.path=my home.txt"]):
        assert command_line() == "marl-clean figure houses 'house.path=my home.txt'"
        with issued(["train", "seed=0"]):
            assert command_line() == "marl-clean train seed=0"
    monkeypatch.setattr("sys.argv", ["/home/me/study.py", "first one"])
    assert command_line() == "study.py 'first one'"
