"""Runs of several seeds are one row, and what is no run is left out in one line."""

import json

import numpy as np
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from marl_clean import compare
from marl_clean.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import MEASURES, make_entry, write_entries

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


def test_runs_on_other_houses_stand_in_a_table_of_their_own(tmp_path) -> None:
    runs = [
        write_run(tmp_path / "a-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "a-s1", ["seed=1"], [40, 60], first_house=9),
    ]
    rows = compare.main(runs, console=QUIET)
    assert [row["policy"] for row in rows] == ["a-s0", "nearest_unknown", "a-s1", "nearest_unknown"]


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
    assert [(one["row"], one["reference"]) for one in paired] == [
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


def test_foreign_and_torn_measurements_are_left_out(tmp_path, caplog) -> None:
    good = write_run(tmp_path / "good", [], [40, 60])
    for name, text in (
        ("torn", '[{"schema": 1, "pol'),
        ("odd", '[{"schema": 1}]'),
        ("list", "[1]"),
    ):
        write_run(tmp_path / name, ["seed=5"], [1, 2])
        (tmp_path / name / "evaluation.json").write_text(text)
    runs = [good, *(str(tmp_path / name) for name in ("torn", "odd", "list"))]
    rows = compare.main(runs, None, QUIET)
    assert [row["policy"] for row in rows] == ["good", "nearest_unknown"]
    assert len(caplog.messages) == 3 and all("\n" not in message for message in caplog.messages)


def test_the_figure_is_drawn(tmp_path, monkeypatch) -> None:
    runs = [
        write_run(tmp_path / "plan", [], [40, 60]),
        write_run(tmp_path / "none", ["comm=none"], [50, 50]),
    ]
    monkeypatch.chdir(tmp_path)
    compare.main(runs, None, QUIET)
    assert {path.name for path in (tmp_path / "runs/figures").iterdir()} == {
        "compare.png",
        "compare.svg",
    }
