"""`compare --silent --oracle`: an oracle of other rules is paired by houses, in table and files."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import marl_clean
from marl_clean.commands import compare
from marl_clean.errors import BadInput
from marl_clean.evaluation.causal import change
from marl_clean.evaluation.records import make_entry, write_entries
from marl_clean.report.recovered import draw_recovered, of_seeds
from tests.commands.test_compare import house, write_run
from tests.commands.test_intervention_part import LISTENING

pytestmark = pytest.mark.usefixtures("unchecked")

PLACES = 20
BASE = np.arange(PLACES)
LEVELS = {"silent": 120, "plan": 90, "oracle": 60}
SETTINGS = {
    "silent": ["comm=none", "env.memory=private"],
    "plan": ["comm=plan", "env.memory=private"],
    "oracle": ["comm=none", "env.memory=merged"],
}


def times(level: int, seed: int) -> list[int]:
    return (level + BASE + np.random.default_rng(seed).integers(-2, 3, PLACES)).tolist()


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Two seeds an arm; the plans' messages zeroed: seed 0 loses what it won, seed 1 does not."""
    monkeypatch.chdir(tmp_path)
    runs: dict[str, list[str]] = {arm: [] for arm in LEVELS}
    for arm, level in LEVELS.items():
        for seed in (0, 1):
            folder = tmp_path / f"{arm}-s{seed}"
            runs[arm].append(
                write_run(folder, [*SETTINGS[arm], f"seed={seed}"], times(level, seed))
            )
    for seed, level in ((0, 130), (1, 91)):
        name = f"plan-s{seed}"
        own = [house(7 + i, time) for i, time in enumerate(times(90, seed))]
        shut = [house(7 + i, time) for i, time in enumerate(times(level, seed))]
        untouched = make_entry(name, "test", "hash", 0.02, 2, own)
        zeroed = make_entry(f"{name} | zero", "test", "hash", 0.02, 2, shut)
        zeroed["change"] = change(zeroed, untouched)
        path = tmp_path / "evaluate" / name / "evaluation.json"
        write_entries(path, [{**untouched, "listening": LISTENING}, zeroed])
    return runs


@pytest.mark.slow
def test_gains_are_in_table_json_csv_and_latex(runs: dict[str, list[str]], tmp_path: Path) -> None:
    console = Console(record=True, width=180, file=io.StringIO())
    compare.main(
        [*runs["plan"], *runs["silent"]],
        tmp_path / "out.json",
        console,
        figure=False,
        export=tmp_path / "export",
        oracle=str(tmp_path / "oracle-s*"),
    )
    plan, silent, planner = json.loads((tmp_path / "out_statistics.json").read_text())
    recovered = plan["recovered"]
    assert (recovered["silent"], recovered["oracle"]) == ("comm=none", "oracle")
    assert recovered["seeds"] == [0, 1]
    means = {arm: np.mean([times(level, seed) for seed in (0, 1)]) for arm, level in LEVELS.items()}
    gap = means["silent"] - means["oracle"]
    wanted = (means["silent"] - means["plan"]) / gap
    assert recovered["T_90"]["value"] == pytest.approx(wanted)
    assert recovered["T_90"]["gap"]["value"] == pytest.approx(gap)
    assert silent["recovered"]["T_90"]["value"] == 0 and "protocols" not in silent
    assert planner["recovered"]["T_90"]["value"] > wanted  # it needs 50 steps
    assert plan["protocols"]["formed"] == [0] and plan["protocols"]["value"] == 0.5
    printed = console.export_text()
    assert "recovered T_90" in printed and "1 of 2 [0.01, 0.99]" in printed
    assert "S: comm=none, O: oracle" in printed
    with (tmp_path / "export" / "statistics.csv").open() as file:
        lines = {
            (line["row"], line["statistic"], line["measure"]): line for line in csv.DictReader(file)
        }
    line = lines["comm=plan", "recovered", "T_90"]
    assert float(line["value"]) == recovered["T_90"]["value"]
    assert (line["against"], line["seeds"]) == ("comm=none / oracle", "2")
    assert float(lines["comm=plan", "protocols", "T_90"]["value"]) == 0.5
    iqm = plan["aggregates"]["T_100"]["iqm"]["value"]
    assert float(lines["comm=plan", "iqm", "T_100"]["value"]) == iqm
    chance = plan["improvement"]["T_100"]["ci95"]
    assert float(lines["comm=plan", "improvement", "T_100"]["high"]) == chance[1]
    latex = (tmp_path / "export" / "tables.tex").read_text()
    assert r"recovered T\_90" in latex and "1 of 2 [0.01, 0.99]" in latex


@pytest.mark.long
def test_rows_and_planners_are_named_by_their_labels(runs: dict[str, list[str]]) -> None:
    arms = [*runs["plan"], *runs["silent"]]
    table = marl_clean.compare(*arms, silent="comm=none", oracle="nearest_unknown")
    plan = table.statistics[0]
    assert plan["recovered"]["oracle"] == "nearest_unknown"
    assert 0 < plan["recovered"]["T_90"]["value"] < 1
    swapped = marl_clean.compare(*arms, silent="comm=plan", oracle="comm=none").statistics[0]
    assert swapped["recovered"]["T_90"]["value"] is None
    assert swapped["recovered"]["T_90"]["gap"]["value"] < 0
    assert all("recovered" not in row for row in marl_clean.compare(*arms).statistics)


@pytest.mark.slow
def test_the_figure_shows_what_every_seed_recovers(
    runs: dict[str, list[str]], tmp_path: Path
) -> None:
    arms = [*runs["plan"], *runs["silent"]]
    [world] = compare.compared(arms, oracle=str(tmp_path / "oracle-s*"))
    plan, silent, _ = world.statistics
    shown = of_seeds(plan, "T_90")
    assert np.mean(shown) == pytest.approx(plan["recovered"]["T_90"]["value"])
    first, second = (np.mean(times(LEVELS["plan"], seed)) for seed in (0, 1))
    gap = plan["recovered"]["T_90"]["gap"]["value"]
    assert shown[1] - shown[0] == pytest.approx((first - second) / gap)

    bits = {"comm=plan": 512.0, "comm=none": 0.0, "nearest_unknown": 0.0}
    panel = draw_recovered("", world.statistics, bits, ["comm=plan"]).axes[0]
    marks = {line.get_label(): line for line in panel.lines if not line.get_label()[0] == "_"}
    assert marks.keys() == {"comm=plan (2 seeds)", "comm=none (2 seeds)"}
    assert marks["comm=plan (2 seeds)"].get_fillstyle() == "none"
    assert marks["comm=none (2 seeds)"].get_fillstyle() == "full"
    assert marks["comm=plan (2 seeds)"].get_xydata().tolist() == [[512.0, np.mean(shown)]]


@pytest.mark.slow
def test_seeds_without_a_twin_are_named(
    runs: dict[str, list[str]], caplog: pytest.LogCaptureFixture
) -> None:
    arms = [*runs["plan"], runs["silent"][1]]
    [world] = compare.compared(arms, silent="comm=none", oracle=runs["oracle"][1])
    plan = world.statistics[0]
    assert plan["recovered"]["seeds"] == plan["protocols"]["seeds"] == [1]
    assert "seeds without a twin in oracle-s1: comm=plan: 0" in caplog.messages
    assert "seeds without a twin in comm=none: comm=plan: 0" in caplog.messages


@pytest.mark.long
def test_what_cannot_be_paired_is_one_line(runs: dict[str, list[str]], tmp_path: Path) -> None:
    arms = [*runs["plan"], *runs["silent"]]
    with pytest.raises(BadInput, match=r"--oracle comm=tarmac: no such row, and no folder"):
        compare.compared(arms, oracle="comm=tarmac")
    with pytest.raises(BadInput, match=r"--oracle .*: its runs are of 2 settings; name one's"):
        compare.compared(arms, oracle=str(tmp_path / "[op]*-s*"))
    with pytest.raises(BadInput, match=r"without communication: none; name one by --silent ROW"):
        compare.compared(runs["plan"], oracle="nearest_unknown")
    write_run(tmp_path / "elsewhere", ["env.memory=merged"], times(60, 0), first_house=90)
    with pytest.raises(BadInput, match=r"--oracle elsewhere: was measured in other houses"):
        compare.compared(arms, oracle="elsewhere")
