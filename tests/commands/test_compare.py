"""Runs of several seeds are one row, and what is no run is left out in one line."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf
from rich.console import Console

import marl_clean
from marl_clean.commands import compare
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import MEASURES, make_entry, write_entries
from tests.families import family
from tests.report.reading import origin_of

pytestmark = pytest.mark.usefixtures("unchecked")

QUIET = Console(quiet=True)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


def house(seed: int, time: int | None) -> dict:
    record = {measure: 1.0 for measure in MEASURES if not measure.endswith("certify")}
    record |= {f"bound_{name}": 10 for name in ("90", "95", "99", "100")}
    record |= {"rows": 10, "cols": 10, "free_cells": 48}
    return record | {"seed": seed, "max_steps": 250, "T_100": time, "T_90": time}


def write_run(folder, overrides: list[str], times: list[int | None], first_house: int = 7) -> str:
    config = compose_config([*overrides, f"name={folder.name}"])
    folder.mkdir()
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
    houses = [house(first_house + i, time) for i, time in enumerate(times)]
    rival = [house(first_house + i, 50) for i in range(len(times))]
    entries = [
        make_entry(folder.name, "test", "hash", 0.02, 2, houses),
        make_entry("nearest_unknown", "test", "hash", 0.0, 2, rival),
    ]
    write_entries(folder / "evaluation.json", entries)
    return str(folder)


@pytest.mark.long
def test_seeds_are_pooled_and_other_settings_are_not(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "plan-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "plan-s1", ["seed=1"], [80, None]),
        write_run(tmp_path / "none-s0", ["comm=none"], [50, 50]),
    ]
    rows = compare.main(runs, tmp_path / "out.json", QUIET)
    assert [row["policy"] for row in rows] == [
        "comm=plan (2 seeds)",
        "comm=none",
        "nearest_unknown",
    ]
    pooled = rows[0]["summary"]["T_100"]
    assert pooled["mean"] == np.mean([40, 60, 80, 250]) and pooled["reached"] == 0.75
    low, high = pooled["ci95"]
    assert low <= 50  # whole runs are drawn, so that one of the seeds may stand alone
    assert high > 120
    assert json.loads((tmp_path / "out.json").read_text()) == rows


@pytest.mark.long
def test_what_is_no_finished_run_is_left_out_in_one_line(tmp_path, caplog) -> None:
    good = write_run(tmp_path / "good", [], [40, 60])
    half = tmp_path / "half"
    half.mkdir()
    (half / "config.yaml").write_text(OmegaConf.to_yaml(compose_config(["name=half"])))
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    rows = compare.main([good, str(half), str(foreign)], console=QUIET)
    assert rows[0]["policy"] == "good"
    assert len(caplog.messages) == 2
    assert "half" in caplog.messages[0] and "foreign" in caplog.messages[1]


@pytest.mark.long
def test_runs_on_other_houses_stand_in_a_table_of_their_own(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "a-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "a-s1", ["seed=1"], [40, 60], first_house=9),
    ]
    rows = compare.main(runs, console=QUIET)
    assert [row["policy"] for row in rows] == ["a-s0", "nearest_unknown", "a-s1", "nearest_unknown"]


@pytest.mark.long
def test_other_rules_of_the_world_are_another_table_with_their_own_planner(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "shared", [], [40, 60]),
        write_run(tmp_path / "private", ["env.memory=private"], [40, 60]),
        write_run(tmp_path / "more-worlds", ["env.num_envs=256"], [40, 60]),
    ]
    rows = [row["policy"] for row in compare.main(runs, console=QUIET)]
    assert rows == [
        "env.num_envs=128",
        "env.num_envs=256",
        "nearest_unknown",
        "private",
        "nearest_unknown",
    ]


def test_no_run_at_all_is_refused(tmp_path) -> None:
    with pytest.raises(BadInput, match="no finished run"):
        compare.main([str(tmp_path / "nothing")], console=QUIET)


@pytest.mark.slow
def test_differences_are_paired_by_seed_and_house_and_corrected(tmp_path) -> None:
    base = np.arange(20) * 10 + 20
    runs = [
        write_run(tmp_path / f"{comm}-s{seed}", [f"comm={comm}", f"seed={seed}"], times.tolist())
        for comm, shift in (("none", 0), ("plan", -5), ("tarmac", 0))
        for seed in (0, 1)
        for times in [base + shift + 100 * seed]
    ]
    compare.main([*runs, runs[0]], tmp_path / "out.json", QUIET)
    paired = json.loads((tmp_path / "out_paired.json").read_text())
    assert [(difference["row"], difference["reference"]) for difference in paired] == [
        ("comm=plan", "comm=none"),
        ("comm=tarmac", "comm=none"),
    ]
    plan, tarmac = paired
    assert plan["seeds"] == [0, 1]
    # Seeds and houses differ by far more than the schemes do; paired that does not matter.
    assert plan["T_90"]["mean"] == -5 and plan["T_90"]["ci95"] == [-5, -5]
    assert plan["T_90"]["p"] == plan["T_90"]["p_holm"] == 0  # it is the same everywhere
    assert tarmac["T_90"]["mean"] == 0 and tarmac["T_90"]["p_holm"] == 1
    assert plan["finished"]["mean"] == 0 and plan["finished"]["p"] == 1


@pytest.mark.long
def test_only_seeds_that_both_have_are_paired_and_the_reference_can_be_chosen(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "plan-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "plan-s1", ["seed=1"], [80, 90]),
        write_run(tmp_path / "none-s1", ["comm=none", "seed=1"], [50, 50]),
    ]
    compare.main(runs, tmp_path / "out.json", QUIET, against="comm=plan")
    [none] = json.loads((tmp_path / "out_paired.json").read_text())
    assert none["row"] == "comm=none" and none["seeds"] == [1]
    assert none["T_100"]["mean"] == -35
    compare.main(runs, tmp_path / "out.json", QUIET, against="nearest_unknown")
    plan, none = json.loads((tmp_path / "out_paired.json").read_text())
    assert plan["T_100"]["mean"] == np.mean([40, 60, 80, 90]) - 50
    with pytest.raises(BadInput, match="--against comm=dial: no such row; did you mean comm=plan"):
        compare.main(runs, None, QUIET, against="comm=dial")


@pytest.mark.slow
def test_seeds_that_cannot_be_paired_are_named_in_one_line(tmp_path, caplog) -> None:
    runs = [
        write_run(tmp_path / f"{comm}-s{seed}", [f"comm={comm}", f"seed={seed}"], [40, 60])
        for comm, seeds in (("none", (0, 1)), ("plan", (1, 2)), ("tarmac", (3,)))
        for seed in seeds
    ]
    compare.main(runs, tmp_path / "out.json", QUIET, figure=False)
    [plan] = json.loads((tmp_path / "out_paired.json").read_text())
    assert plan["row"] == "comm=plan" and plan["seeds"] == [1]
    [line] = caplog.messages
    assert (
        line == "seeds that comm=none cannot be paired with: comm=plan: 0, 2; comm=tarmac: 0, 1, 3"
    )
    compare.main([*runs[:1], *runs[4:]], tmp_path / "out.json", QUIET, figure=False)
    assert json.loads((tmp_path / "out_paired.json").read_text()) == []


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """Two finished runs, written once."""
    place = tmp_path_factory.mktemp("written")
    write_run(place / "good", [], [40, 60])
    write_run(place / "foreign", ["seed=5"], [1, 2])
    return place


@pytest.fixture
def pair(written, tmp_path) -> list[str]:
    """The two, to be changed."""
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    return [str(tmp_path / "good"), str(tmp_path / "foreign")]


def of_houses(**changes):
    def change(entry: dict) -> None:
        for record in entry["houses"]:
            record.update(changes)

    return change


def without(key: str):
    def change(entry: dict) -> None:
        for record in entry["houses"]:
            del record[key]

    return change


FOREIGN = {
    "no summary": lambda entry: entry.pop("summary"),
    "no policy": lambda entry: entry.pop("policy"),
    "a policy of several": lambda entry: entry.update(policy=["a"]),
    "no houses": lambda entry: entry.update(houses=[]),
    "houses by name": lambda entry: entry.update(houses={"a": 1}),
    "a house that is none": lambda entry: entry["houses"].append(3),
    "a house that lacks a measure": lambda entry: entry["houses"][1].pop("bumps"),
    "no time at all": without("T_90"),
    "no most of steps": without("max_steps"),
    "unlimited steps": of_houses(max_steps=None),
    "no bound": without("bound_90"),
    "a time in words": of_houses(T_90="soon"),
    "an endless time": of_houses(T_90=float("inf")),
    "a mean in words": lambda entry: entry["summary"]["T_90"].update(mean="soon"),
    "an interval of one end": lambda entry: entry["summary"]["T_100"].update(ci95=[1.0]),
    "no mean": lambda entry: entry["summary"]["coverage"].update(mean=None),
    "another version": lambda entry: entry.update(schema=2),
}


@family("what", FOREIGN, fast=4)
def test_a_foreign_entry_leaves_its_run_out_in_one_line(what, pair, tmp_path, caplog) -> None:
    path = tmp_path / "foreign" / "evaluation.json"
    entries = json.loads(path.read_text())
    FOREIGN[what](entries[0])
    path.write_text(json.dumps(entries))
    rows = compare.main(pair, None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == ["good", "nearest_unknown"]
    [line] = caplog.messages
    assert str(path) in line and "\n" not in line


@pytest.mark.parametrize(
    "text", [b'[{"schema": 1, "pol', b"[1]", b"3", b"{}", b"", b"\xff\xfe", b"[" * 100_000]
)
def test_a_torn_measurement_is_left_out_in_one_line(text, pair, tmp_path, caplog) -> None:
    (tmp_path / "foreign" / "evaluation.json").write_bytes(text)
    rows = compare.main(pair, None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == ["good", "nearest_unknown"]
    assert len(caplog.messages) == 1 and "\n" not in caplog.messages[0]


@pytest.mark.parametrize(
    "text", [b"", b"- 1", b"\xff\xfea: 1", b"seed: 0\nhou", b"model:\n  _target_: os.system\n"]
)
def test_an_untrusted_config_is_left_out_in_one_line(text, pair, tmp_path, caplog) -> None:
    (tmp_path / "foreign" / "config.yaml").write_bytes(text)
    rows = compare.main(pair, None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == ["good", "nearest_unknown"]
    assert len(caplog.messages) == 1 and "\n" not in caplog.messages[0]


@pytest.mark.parametrize("kept", [slice(1, None), slice(0)])
def test_a_run_measured_without_its_own_policy_is_left_out(kept, pair, tmp_path, caplog) -> None:
    path = tmp_path / "foreign" / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text())[kept]))
    rows = compare.main(pair, None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == ["good", "nearest_unknown"]
    assert len(caplog.messages) == 1 and str(path) in caplog.messages[0]


@pytest.mark.slow
def test_entries_of_before_a_measure_are_pooled_without_it(tmp_path, caplog) -> None:
    runs = [
        write_run(tmp_path / f"plan-s{seed}", [f"seed={seed}"], [40, 60 + seed]) for seed in (0, 1)
    ]
    path = tmp_path / "plan-s1" / "evaluation.json"
    entries = json.loads(path.read_text())
    for entry in entries:
        del entry["summary"]["bits_per_cell"], entry["summary"]["gate"]
        without("bits_per_cell")(entry)
        without("gate")(entry)
    path.write_text(json.dumps(entries))
    for order in (runs, runs[::-1]):
        row, _ = compare.main(order, None, QUIET, figure=False)
        assert row["policy"] == "plan (2 seeds)" and "gate" not in row["summary"]
    assert caplog.messages == []


@pytest.mark.slow
def test_tasks_of_others_are_compared_by_their_return(tmp_path) -> None:
    def write_task(comm: str, returns: list[float]) -> str:
        folder = tmp_path / comm
        folder.mkdir()
        config = compose_config(["experiment=spread", f"comm={comm}", f"name={comm}"])
        (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
        houses = [{"seed": i, "steps": 25, "return": value} for i, value in enumerate(returns)]
        entry = make_entry(comm, "mpe2.simple_spread_v3", "hash", 0.02, 3, houses)
        write_entries(folder / "evaluation.json", [{**entry, "world": None}])
        return str(folder)

    runs = [write_task("none", [-60.0, -70.0]), write_task("plan", [-50.0, -61.0])]
    compare.main(runs, tmp_path / "out.json", QUIET)
    [plan] = json.loads((tmp_path / "out_paired.json").read_text())
    assert plan["return"]["mean"] == 9.5 and "T_90" not in plan


@pytest.mark.slow
def test_a_silent_row_is_the_reference_wherever_it_stands(tmp_path) -> None:
    runs = [
        write_run(tmp_path / f"{comm}-{reward}", [f"comm={comm}", f"reward={reward}"], [40, 60])
        for comm in ("plan", "none")
        for reward in ("team", "individual")
    ]
    compare.main(runs, tmp_path / "out.json", QUIET, figure=False)
    paired = json.loads((tmp_path / "out_paired.json").read_text())
    assert {difference["reference"] for difference in paired} == {"reward=team comm=none"}


@pytest.mark.long
def test_the_figures_are_drawn_with_every_seed(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "plan-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "plan-s1", ["seed=1"], [44, None]),
        write_run(tmp_path / "none", ["comm=none"], [50, 50]),
    ]
    compare.main(runs, None, QUIET)
    figures = tmp_path / "runs/figures"
    stems = ("compare", "compare_profiles", "compare_improvement")
    assert {path.name for path in figures.iterdir()} == {
        f"{stem}.{kind}" for stem in stems for kind in ("svg", "png")
    }
    for stem, texts in {
        "compare": (
            "T_90 / nearest_unknown's",
            "T_100 minus reference's",
            "may be chance",
            "a seed",
        ),
        "compare_profiles": ("share of houses finished", "nearest_unknown"),
        "compare_improvement": ("reference: comm=none",),
    }.items():
        assert origin_of(figures / f"{stem}.png")[1] == ["hash"]
        drawn = (figures / f"{stem}.svg").read_text()
        for text in (*texts, "comm=plan (2 seeds)"):
            assert text in drawn


@pytest.mark.slow
def test_every_row_has_its_statistics_and_its_seeds(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "plan-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "plan-s1", ["seed=1"], [50, None]),
        write_run(tmp_path / "none", ["comm=none"], [50, 70]),
    ]
    console = Console(record=True, width=180, file=io.StringIO())
    compare.main(runs, tmp_path / "out.json", console, figure=False)
    plan, none, planner = json.loads((tmp_path / "out_statistics.json").read_text())
    assert plan["seeds"] == [0, 1] and plan["by_seed"]["T_100"] == [50, 150]
    assert planner["seeds"] == [] and "improvement" not in none
    # House by house: 40 and 50 against 50; 60 and never against 70.
    assert plan["improvement"]["T_100"]["value"] == (1.5 / 2 + 1 / 2) / 2
    gap = plan["aggregates"]["score"]["optimality_gap"]
    assert gap["value"] == pytest.approx(1 - np.mean([10 / 40, 10 / 60, 10 / 50, 0]))
    assert plan["finished_by"]["share"][-1] == 0.75
    low, high = plan["aggregates"]["T_100"]["iqm"]["ci95"]
    assert low <= plan["aggregates"]["T_100"]["iqm"]["value"] == 55 <= high
    [line] = [line for line in console.export_text().splitlines() if "0.62 [" in line]
    assert line.split()[:2] == ["comm=plan", "2"] and "55.0 [" in line
    table = marl_clean.compare(*runs)
    assert table.statistics == [plan, none, planner]
