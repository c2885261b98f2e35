"""evaluation.json says what was measured, and a time not reached is never forgotten."""

import io
import json

import pytest
from rich.console import Console

from marl_clean.errors import BadInput
from marl_clean.evaluation import records
from marl_clean.evaluation.records import (
    MEASURES,
    counted,
    make_entry,
    read_entries,
    summarise,
    write_entries,
)
from marl_clean.evaluation.table import make_table, percent


def house_of(seed: int, time: int | None, bound: int | None = 20, **changes) -> dict:
    """A record whose times are all `time`, of a house with 100 steps."""
    house = {"seed": seed, "rows": 3, "cols": 7, "free_cells": 21, "max_steps": 100}
    house |= {f"bound_{name}": bound for name in records.TIMES}
    house |= {measure: 1.0 for measure in MEASURES}
    house |= {f"T_{name}": time for name in records.TIMES}
    ratio = time / bound if time and bound else None
    house |= {f"ratio_{name}": ratio for name in records.TIMES}
    return house | changes


def entry_of(policy: str, times: list[int | None], house_set: str = "test") -> dict:
    houses = [house_of(seed, time) for seed, time in enumerate(times)]
    return make_entry(policy, house_set, "ab" * 32, 0.0, 2, houses)


def test_a_time_not_reached_counts_as_max_steps_in_means_and_not_as_reached():
    summary = summarise([[house_of(0, 40), house_of(1, 60), house_of(2, None), house_of(3, 40)]])
    assert summary["T_100"]["mean"] == 60.0
    assert summary["T_100"]["reached"] == 0.75
    assert summary["T_100"]["iqm"] == 50.0
    assert summary["ratio_100"]["mean"] == 3.0
    low, high = summary["T_100"]["ci95"]
    assert 40.0 <= low < 60.0 < high <= 100.0


def test_a_ratio_to_no_bound_is_left_out_of_the_mean():
    houses = [house_of(0, 40), house_of(1, 40, bound=0), house_of(2, None, bound=None)]
    assert counted(houses[1], "ratio_100") is None and counted(houses[2], "ratio_90") is None
    summary = summarise([houses])
    assert summary["ratio_100"]["mean"] == 2.0
    assert summary["ratio_100"]["reached"] == pytest.approx(1 / 3)


def test_houses_of_several_runs_are_kept_apart():
    runs = [[house_of(seed, time) for seed in range(4)] for time in (20, 40, 90)]
    summary = summarise(runs)
    assert summary["T_90"]["mean"] == 50.0 and summary["T_90"]["ci95"] == [20.0, 90.0]


def test_what_is_measured_on_demand_may_be_absent():
    house = house_of(0, 40)
    del house["T_certify"], house["ratio_certify"]
    assert "T_certify" not in summarise([[house]])
    assert list(summarise([[house_of(0, 40)]])) == list(MEASURES)


def test_a_file_is_read_as_written_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "deep" / "evaluation.json"
    entries = [entry_of("random", [40, None])]
    write_entries(path, entries)
    assert read_entries(path) == entries
    assert [file.name for file in path.parent.iterdir()] == ["evaluation.json"]
    entry = json.loads(path.read_text())[0]
    assert list(entry) == [
        "schema", "world", "policy", "house_set", "config_hash", "epsilon", "n_agents",
        "houses", "summary",
    ]  # fmt: skip


def test_a_failed_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "evaluation.json"
    write_entries(path, [entry_of("random", [40])])
    before = path.read_bytes()
    with pytest.raises(ValueError):
        write_entries(path, [{"mean": float("nan")}])
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("text", ["{", "{}", "[1]", '[{"schema": 2}]'])
def test_what_is_no_evaluation_is_bad_input(tmp_path, text):
    path = tmp_path / "evaluation.json"
    path.write_text(text)
    with pytest.raises(BadInput, match="valid"):
        read_entries(path)


def test_the_table_shows_finished_intervals_and_the_ratio_to_the_planner():
    entries = [entry_of("random", [100, None]), entry_of("nearest_unknown", [40, 60])]
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(make_table(entries))
    text = console.export_text()
    row = next(line for line in text.splitlines() if "random" in line)
    assert "50.0 %" in row and "100.0 [100.0, 100.0]" in row and "2.00" in row
    assert "counts as its max_steps" in " ".join(text.split())


def test_a_hundred_per_cent_means_all_of_them():
    assert percent(1.0) == "100.0 %" and percent(0.99999) == "99.9 %"
    assert percent(0.57) == "57.0 %"
