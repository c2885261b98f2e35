"""What planners gain by knowing more is measured on the same houses, and what is wrong refused."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from marl_clean import build
from marl_clean.commands import headroom
from marl_clean.commands._headroom_settings import make_plan
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.evaluation.headroom import row_in
from marl_clean.evaluation.planner_play import play

SMALL = ["headroom.sides=[7]", "headroom.robots=[3]", "headroom.reaches=[2,full]"]
SMALL += ["headroom.houses=6", "headroom.losses=[0,0.8,1]"]


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small grid, played once; its json."""
    path = tmp_path_factory.mktemp("grid") / "small.json"
    console = Console(record=True, width=200, file=io.StringIO())
    headroom.run([*SMALL, f"out={path}"], console)
    (path.parent / "printed.txt").write_text(console.export_text())
    return path


@pytest.mark.slow
def test_rows_are_what_evaluate_measures(grid: Path) -> None:
    rows = json.loads(grid.read_text())
    assert len(rows) == 3 * (2 + 2 * 3)
    merged = {"house": "7x7", "n_agents": 3, "reach": 2, "channel": "perfect"}
    for memory, assignment in (("private", "none"), ("merged", "greedy"), ("shared", "none")):
        settings = ["house.rows=[7,7]", "house.cols=[7,7]", "env.n_agents=3"]
        settings += [f"env.memory={memory}", f"planner.assignment={assignment}"]
        cfg = compose_config([*settings, "topology.view_size=5"])
        records = evaluate(
            cfg, lambda env, cfg=cfg: build.make_planner(cfg, env), house_set="test", count=6
        )
        wanted = np.mean([house["T_90"] or house["max_steps"] for house in records])
        row = row_in(rows, merged, memory, assignment)
        assert row["T_90"] == pytest.approx(wanted)
        assert row["T_90_low"] <= row["T_90"] <= row["T_90_high"]


def test_gains_are_ratios_to_private_maps_and_to_no_assignment(grid: Path) -> None:
    rows = json.loads(grid.read_text())
    [private] = [r for r in rows if (r["memory"], r["assignment"]) == ("private", "none")]
    assert private["T_90_headroom"] == private["T_90_coordination"] == 1
    assert (private["T_90_headroom_low"], private["T_90_headroom_high"]) == (1, 1)
    for row in rows:
        same = row_in(rows, row, row["memory"], "none")
        for measure in ("T_90", "T_100"):
            assert row[f"{measure}_headroom"] == pytest.approx(private[measure] / row[measure])
            assert row[f"{measure}_coordination"] == pytest.approx(same[measure] / row[measure])


@pytest.mark.slow
def test_merging_is_bounded_by_private_and_shared_maps(grid: Path) -> None:
    """All lost is private, house by house; nothing lost at full reach is one map for all."""
    times = {
        (item.cell.reach, item.cell.channel, item.memory.value): [
            house["T_100"] for house in play(item.config)
        ]
        for item in make_plan(SMALL).plays
        if item.assignment.value == "none"
    }
    private, shared = times[None, None, "private"], times[None, None, "shared"]
    assert times["full", "loss 1", "merged"] == private != shared
    assert times["full", "perfect", "merged"] == shared
    assert times["full", "loss 0.8", "merged"] not in (private, shared)


@pytest.mark.slow
def test_a_lossy_channel_thins_contacts_by_its_share() -> None:
    [item] = [
        item
        for item in make_plan([*SMALL, "headroom.houses=200"]).plays
        if (item.cell.reach, item.cell.channel) == ("full", "loss 0.8")
        and item.assignment.value == "none"
    ]
    from marl_clean.evaluation import planner_play

    seen = []
    before = planner_play.arriving

    def watched(contact, channels, env):
        heard = before(contact, channels, env)

        def counted(state, rules):
            edges = heard(state, rules)
            assert not (edges & ~contact(state, rules)).any()
            seen.append(edges)
            return edges

        return counted

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner_play, "arriving", watched)
        play(item.config)
    alive = torch.cat(seen)
    assert alive.float().mean() * 9 / 6 == pytest.approx(0.2, abs=0.01)
    assert (seen[1] != seen[2]).any() and (alive != alive.mT).any()  # each step and direction anew


def test_files_and_table_say_the_same(grid: Path) -> None:
    rows = json.loads(grid.read_text())
    with grid.with_suffix(".csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["T_90_headroom"]) for line in lines] == [r["T_90_headroom"] for r in rows]
    assert lines[0]["reach"] == "" and lines[-1]["reach"] == "full"
    printed = (grid.parent / "printed.txt").read_text()
    cell = row_in(rows, {**rows[0], "reach": 2, "channel": "loss 0.8"}, "merged", "none")
    assert f"{cell['T_90_headroom']:.2f} [{cell['T_90_headroom_low']:.2f}, " in printed
    assert "maps of others: in" in printed and "do not train there" in printed
    drawn = grid.with_suffix(".svg").read_text()
    assert f"{cell['T_90_headroom']:.2f}" in drawn and "3 robots" in drawn
    assert grid.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_floor_plan_has_no_sides(tmp_path: Path) -> None:
    settings = ["house=floorplan", "house.path=apartment", "headroom.robots=[2]"]
    plan = make_plan([*settings, "headroom.reaches=[4]", "topology=radius"])
    assert {play.cell.place for play in plan.plays} == {"apartment"}
    assert plan.plays[-1].config.topology.radius_cells == 4
    with pytest.raises(BadInput, match=r"headroom\.sides: houses of house=floorplan have their"):
        make_plan([*settings, "headroom.sides=[8]"])


@pytest.mark.long
def test_the_default_grid_has_sixty_cells() -> None:
    cells = {play.cell for play in make_plan([]).plays if play.cell.reach is not None}
    assert len(cells) == 60
    assert all(play.config.evaluation.houses == 40 for play in make_plan([]).plays[:1])


@pytest.mark.long
def test_no_scheme_speaks_between_planners() -> None:
    """`comm=delta` would tell private maps what others have cleaned."""
    spoken = make_plan([*SMALL, "comm=delta"]).plays[0]
    assert [house["T_100"] for house in play(spoken.config)] == [
        house["T_100"] for house in play(make_plan(SMALL).plays[0].config)
    ]
