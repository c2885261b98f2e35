"""Interventions stand on the page of their run, with the numbers that `evaluate` printed."""

import json
from pathlib import Path
from typing import Any

import pytest

from marl_clean.commands.gathering import gather, rows_of
from marl_clean.commands.intervention_part import interventions_of
from marl_clean.commands.report import folders_of
from marl_clean.evaluation.causal import change, make_causal_tables
from marl_clean.evaluation.intervened import LISTENED, REPLACED
from marl_clean.evaluation.records import make_entry, write_entries
from marl_clean.report.html import Part
from tests.commands.test_compare import house, write_run

pytestmark = pytest.mark.usefixtures("unchecked")

MEAN = {"mean": 0.25, "ci95": [0.125, 0.5]}
LISTENING = {
    "temperature": 1.0,
    "messages": 8,
    **{f"{name}_{column}": MEAN for name in REPLACED for column in LISTENED},
    "cic": {"mean": None, "ci95": None},
}


def entries_of(name: str, added: int, listening: Any = LISTENING) -> list[dict[str, Any]]:
    untouched = make_entry(name, "test", "hash", 0.02, 2, [house(7, 40), house(8, 60)])
    houses = [house(7, 40 + added), house(8, 60 + added)]
    shut = make_entry(f"{name} | shut", "test", "hash", 0.02, 2, houses)
    changed = {**shut, "change": change(shut, untouched)}
    return [{**untouched, "listening": listening}, changed]


def parts_of(runs: list[str]) -> list[Part]:
    worlds = gather(runs)
    [world] = worlds.values()
    short = {row.label: "plan" for row in rows_of(world)}
    return interventions_of([world], folders_of([world]), [short])


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    runs = [write_run(tmp_path / f"plan-s{seed}", [f"seed={seed}"], [40, 60]) for seed in (0, 1)]
    for seed in (0, 1):
        path = tmp_path / "evaluate" / f"plan-s{seed}" / "evaluation.json"
        write_entries(path, entries_of(f"plan-s{seed}", 10 + 20 * seed))
    return runs


@pytest.mark.slow
def test_seeds_are_pooled_against_the_untouched_runs(runs: list[str]) -> None:
    [part] = parts_of(runs)
    (caption, rows), (_, listening) = part.tables
    assert caption.startswith("plan, minus untouched")
    assert rows[0] == ["messages", "seeds", "T_90", "T_100", "finished"]
    assert rows[1][:2] == ["shut", "2"] and rows[1][3].startswith("+20.0 [")
    assert [line[:3] for line in listening] == [
        ["policy", "seed", "replaced by"],
        *(["plan", str(seed), name] for seed in (0, 1) for name in REPLACED),
    ]
    assert listening[1][3] == "0.250 [0.125, 0.500]"
    [plot] = part.plots
    assert plot.numbers[1][1].startswith("+20.0 [")


@pytest.mark.slow
def test_of_one_seed_the_cells_are_those_of_the_terminal(runs: list[str]) -> None:
    [part] = parts_of(runs[:1])
    printed, listening = make_causal_tables(entries_of("plan-s0", 10))
    column = next(each for each in printed.columns if each.header == "T_100")
    assert [str(cell) for cell in column.cells] == [part.tables[0][1][1][3]]
    shown = [[str(cell) for cell in each.cells] for each in listening.columns]
    assert [line[2:] for line in part.tables[1][1][1:]] == [
        list(line) for line in zip(*shown, strict=True)
    ]


@pytest.mark.slow
def test_a_run_without_interventions_has_no_part(tmp_path: Path) -> None:
    run = write_run(tmp_path / "plan-s0", [], [40, 60])
    assert parts_of([run]) == []


@pytest.mark.parametrize(
    "listening",
    [None, {}, {**LISTENING, "cic": {"mean": "<b>"}}, {**LISTENING, "cic": MEAN | {"ci95": None}}],
)
def test_what_is_damaged_is_left_out_in_one_line(
    listening: Any, runs: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    path = Path("evaluate/plan-s0/evaluation.json")
    path.write_text(json.dumps(entries_of("plan-s0", 10, listening)))
    [part] = parts_of(runs)
    assert part.tables[0][1][1][1] == "1"
    assert sum("evaluate/plan-s0" in record.getMessage() for record in caplog.records) == 1


@pytest.mark.slow
def test_interventions_in_a_runs_own_file_are_no_planners(runs: list[str]) -> None:
    own = Path(runs[0], "evaluation.json")
    own.write_text(json.dumps([*entries_of("plan-s0", 10)]))
    [world] = gather(runs[:1]).values()
    assert list(world.planners) == []
    [part] = parts_of(runs[:1])
    assert part.tables[0][1][1][0] == "shut"
