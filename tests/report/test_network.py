"""Figures 3 and 4 come from the modules: another layer, cell or robot gives another figure."""

import io

import matplotlib
import pytest

from marl_clean import keys
from marl_clean.config.compose import compose_config
from marl_clean.report.axes import STYLE
from marl_clean.report.figures import _watched, draw_figure
from tests.families import family

SIZES = ["house.rows=[6,7]", "house.cols=[8,9]"]
SMALL = [
    "observation.view_size=7",
    "encoder.channels=[4,6]",
    "encoder.strides=[1,2]",
    "encoder.hidden=[12]",
    "evaluation.houses=2",
]


FIRST = ("paper_1", "paper_2")


def drawn(name: str, *overrides: str) -> tuple[bytes, list[str]]:
    """The figure as svg, and all that is written in it."""
    sizes = [] if "house=drawn" in overrides else SIZES
    figure = draw_figure(name, compose_config([*SMALL, *sizes, *overrides]))
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue(), [text.get_text() for text in figure.axes[0].texts]


@pytest.mark.slow
def test_figure_3_shows_the_layers_that_ran_with_their_shapes():
    _, texts = drawn("paper_3", "comm=none")
    assert texts[:5] == [
        "state of robot 1\n7 x 7",
        "conv 3x3\n4 x 7 x 7",
        "conv 3x3 / 2\n6 x 4 x 4",
        "FCL\n12",
        "FCL\n5",  # the state's value and four advantages
    ]
    assert [text.split(" =")[0] for text in texts[5:]] == [
        "Q(0 up)", "Q(1 right)", "Q(2 down)", "Q(3 left)",
    ]  # fmt: skip


@family(
    "change",
    ["encoder.hidden=[12,10]", "encoder.channels=[4,8]", "agent.dueling=false", "comm=plan"],
    fast=1,
)
def test_another_layer_changes_figure_3(change):
    before, texts = drawn("paper_3", "comm=none")
    after, changed = drawn("paper_3", "comm=none", change)
    assert before != after and texts != changed


@pytest.mark.slow
def test_the_same_settings_give_the_same_figure():
    assert drawn("paper_4")[0] == drawn("paper_4")[0]


@pytest.mark.slow
def test_another_number_of_robots_changes_figure_4():
    pictures = {count: drawn("paper_4", f"env.n_agents={count}")[1] for count in (2, 3)}
    for count, texts in pictures.items():
        states = [text for text in texts if text.startswith("state of robot")]
        assert len(states) == count
        assert sum(text.startswith("received FCL") for text in texts) == count - 1


@pytest.mark.slow
def test_another_size_of_message_changes_figure_4():
    assert "message FCL\n5" in drawn("paper_4", "comm.message_dim=5")[1]


@pytest.mark.slow
def test_one_other_cell_changes_figures_1_and_2(tmp_path):
    plan = ["#######", "#S....#", "#..#..#", "#....S#", "#######"]
    pictures = []
    for cell in "#.":
        plan[2] = f"#..#.{cell}#"
        path = tmp_path / "plan.txt"
        path.write_text("\n".join(plan))
        settings = ("house=drawn", f"house.path='{path}'", "env.knowledge=memorised")
        pictures.append([drawn(name, *settings)[0] for name in FIRST])
    assert all(before != after for before, after in zip(*pictures, strict=True))


@pytest.mark.slow
def test_the_central_controller_values_joint_actions():
    _, texts = drawn("paper_4", "experiment=paper_central", "observation.view_size=7")
    assert "FCL\n17" in texts  # a value and 16 advantages
    assert sum(text.startswith("Q(") for text in texts) == 8


def test_the_bold_value_is_that_of_the_chosen_action():
    cfg = compose_config([*SMALL])
    _, answered = _watched(cfg)
    figure = draw_figure("paper_4", cfg)
    (bold,) = [text for text in figure.axes[0].texts if text.get_weight() == "bold"]
    assert bold.get_text().startswith(f"Q({int(answered[keys.ACTION][0, 0])} ")
