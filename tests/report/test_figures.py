"""Figures come from live objects, and the commands that show things say what they did."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from marl_clean.commands import evaluate, figure, watch
from marl_clean.commands.command_line import issued
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.env import viewer
from marl_clean.errors import BadInput
from marl_clean.house.base import Houses
from marl_clean.report import figures
from marl_clean.report.figures import digits, draw_figure, house_colours, memory_colours
from tests.report.reading import origin_of

SMALL = ["house.rows=[5, 6]", "house.cols=[7, 9]", "env.max_steps=30", "observation.view_size=5"]


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(scope="module")
def cfg():
    return compose_config([*SMALL, "topology.view_size=5", "evaluation.houses=3"])


def quiet() -> Console:
    return Console(file=io.StringIO(), width=200)


@pytest.mark.parametrize(("rows", "cols"), [(3, 7), (7, 3)])
def test_a_plan_is_drawn_without_the_padding_of_its_stack(rows, cols):
    free, furniture = np.zeros((1, 8, 8), dtype=bool), np.zeros((1, 8, 8), dtype=np.int16)
    free[0, :rows, :cols] = True
    free[0, 0, 2] = free[0, 2, 1] = False
    furniture[0, 2, 1] = 1
    sizes = np.array([rows]), np.array([cols])
    colours = house_colours(Houses(free, furniture, *sizes, starts=None, sources=[1]), 0)
    assert colours.shape == (rows, cols, 3)
    assert tuple(colours[0, 2]) == viewer.WALL and tuple(colours[2, 1]) == viewer.FURNITURE
    is_floor = np.ones((rows, cols), dtype=bool)
    is_floor[0, 2] = is_floor[2, 1] = False
    assert (colours[is_floor] == viewer.DIRTY).all()


def test_memory_is_in_the_papers_greys():
    colours = memory_colours(np.array([[-1.0, -0.2, 0.0], [0.5, 1.0, 0.3]]))
    assert tuple(colours[0, 0]) == viewer.BLOCKED
    assert tuple(colours[0, 1]) == figures.PAPER_UNKNOWN
    assert (colours[[0, 1, 1, 1], [2, 0, 1, 2]] == figures.PAPER_VISITED).all()


@pytest.mark.parametrize(
    ("value", "text"),
    [(-1.0, "-1"), (-0.2, "-.2"), (0.0, "0"), (0.45, ".45"), (0.5, ".5"), (0.004, "0"), (1.0, "1")],
)
def test_values_are_written_in_few_digits(value, text):
    assert digits(value) == text


@pytest.mark.slow
def test_the_view_in_figure_2_is_what_the_network_gets(cfg):
    drawn = draw_figure("paper_2", cfg)
    seen = drawn.axes[1]
    texts = np.array([text.get_text() for text in seen.texts]).reshape(5, 5)
    assert texts[2, 2] == "1"  # the robot itself, in the middle
    assert (texts == "-1").any() and (texts == "-.2").any()


@pytest.mark.long
def test_every_figure_is_written_as_svg_and_png(cfg, tmp_path, monkeypatch):
    monkeypatch.setattr(figure, "RUNS", tmp_path)
    for name in figure.NAMES:
        with issued(["figure", name, *SMALL]):
            svg, png = figure.main(name, cfg, quiet())
        command = f"marl-clean figure {name} 'house.rows=[5, 6]'"
        for path in (svg, png):
            source, hashes = origin_of(path)
            assert source.startswith(command) and hashes == [config_hash(cfg)]
        assert (svg, png) == (
            tmp_path / "figures" / f"{name}.svg",
            tmp_path / "figures" / f"{name}.png",
        )
        assert svg.read_text().startswith("<?xml") and png.read_bytes()[1:4] == b"PNG"
    assert figure.NAMES == tuple(figures.FIGURES)


@pytest.mark.slow
@pytest.mark.parametrize("level", ["compass", "distances", "global_map"])
def test_what_is_no_square_around_the_robot_is_refused_by_figure_2(level):
    cfg = compose_config([f"observation={level}"])
    with pytest.raises(BadInput, match=f"observation={level}: figure paper_2 needs a square"):
        figure.main("paper_2", cfg)


def test_a_misspelt_figure_is_bad_input_that_lists_them(cfg):
    with pytest.raises(BadInput, match="did you mean paper_1.*houses, memory, paper_1, paper_2"):
        figure.main("paper1", cfg)


@pytest.mark.slow
def test_watch_plays_every_step_on_a_terminal_and_shows_the_end_in_a_file(cfg, monkeypatch):
    delays: list[float] = []
    screen, file = Terminal(), io.StringIO()
    monkeypatch.setattr("sys.stdout", screen)
    watch.main(cfg, frames_per_second=20.0, sleep=delays.append)
    monkeypatch.setattr("sys.stdout", file)
    watch.main(cfg)
    frames = screen.getvalue().split(watch.HOME)[1:]
    assert len(delays) == len(frames) and set(delays) == {0.05}
    last = file.getvalue()
    assert "\x1b" not in last and last.count("step") == 1
    assert f"step {len(frames) - 1} " in last
    assert screen.getvalue().endswith(watch.SHOW_CURSOR)


def test_the_cursor_comes_back_when_a_play_is_interrupted(cfg, monkeypatch):
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    screen = Terminal()
    monkeypatch.setattr("sys.stdout", screen)
    with pytest.raises(KeyboardInterrupt):
        watch.main(cfg, sleep=interrupt)
    assert screen.getvalue().endswith(watch.SHOW_CURSOR)


@pytest.mark.slow
def test_evaluate_writes_the_planners_entry_and_prints_its_row(cfg, tmp_path):
    console, out = quiet(), tmp_path / "deep" / "out.json"
    evaluate.main(cfg, out, console)
    (entry,) = json.loads(out.read_text())
    assert entry["policy"] == "nearest_unknown" and len(entry["houses"]) == 3
    assert "nearest_unknown" in console.file.getvalue() and str(out) in console.file.getvalue()
