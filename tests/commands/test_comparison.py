"""The comparisons: every row composes, one is trained and drawn, wrong settings start nothing."""

import io
import re

import pytest
from omegaconf import DictConfig
from rich.console import Console

from marl_clean.commands import comparison, train
from marl_clean.commands.compare import tables_of
from marl_clean.commands.comparison import COMPARISONS, jobs_of
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import load_config
from marl_clean.errors import BadInput
from tests.families import family
from tests.report.reading import origin_of

pytestmark = pytest.mark.usefixtures("unchecked")

TINY = [
    "budget=smoke",
    "trainer.total_frames=512",
    "trainer.frames_per_batch=128",
    "trainer.start_frames=128",
    "trainer.eval_interval_frames=512",
    "env.num_envs=16",
    "env.max_steps=20",
    "house.rows=[6,6]",
    "house.cols=[7,7]",
    "train_houses=4",
    "evaluation.plans=[]",
    "evaluation.houses=3",
]


@family("name", COMPARISONS, fast=1)
def test_the_rows_of_a_comparison_are_different_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seeds = [0, 1] if name == next(iter(COMPARISONS)) else [0]
    jobs = jobs_of(name, ["budget=smoke", f"seed={','.join(map(str, seeds))}"])
    assert list(jobs) == list(COMPARISONS[name].rows)
    hashes = [config_hash(config) for configs in jobs.values() for config in configs]
    assert len(set(hashes)) == len(hashes) == len(seeds) * len(jobs)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("name=mine", "^name: figure approaches trains runs of its own"),
        ("experiment=quick", "^experiment: "),
        ("agent.lr=abc", "^agent.lr: must be a number"),
        ("budget=huge", "valid: full, small, smoke"),
    ],
)
def test_a_wrong_setting_trains_nothing(setting, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match=message):
        comparison.main("approaches", [setting])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_comparison_trains_what_it_lacks_and_names_its_budget(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "draw", lambda config, folder: None)  # a run's own pictures
    console = Console(file=io.StringIO(), width=200)
    svg, png = comparison.main("sensors", [*TINY, "seed=0,1"], console)
    assert len(list((tmp_path / "runs").glob("*/evaluation.json"))) == 4
    text = svg.read_text()
    for label in COMPARISONS["sensors"].rows:
        assert label in text
    assert re.search(r"budget=smoke: 512 frames, 2 run\(s\) a row, 3 houses", text)
    hashes = {config_hash(DictConfig(load_config(run))) for run in (tmp_path / "runs").glob("*-*")}
    assert set(origin_of(svg)[1]) == set(origin_of(png)[1]) == hashes and len(hashes) == 4

    trained = []
    monkeypatch.setattr(train, "measure_all", lambda *arguments: trained.append(arguments))
    assert comparison.main("sensors", [*TINY, "seed=0,1"], console) == [svg, png]
    assert trained == []


def entry(policy: str, house_set: str, rows: int, steps: float) -> dict:
    houses = [{"seed": seed, "rows": rows, "cols": rows, "T_90": steps} for seed in range(3)]
    return {"policy": policy, "house_set": house_set, "n_agents": 2, "houses": houses}


def run_entries(policy: str, rows: int, steps: float) -> list[dict]:
    sets = (("test", rows), ("test 8x8", 8))
    return [entry(p, *s, steps) for s in sets for p in (policy, "random", "nearest_unknown")]


def test_rows_are_compared_on_the_houses_that_all_were_measured_on():
    runs = {"large": [run_entries("a", 20, 1)], "small": [run_entries("b", 10, 2)]}
    [table] = tables_of(runs)
    assert list(table) == ["large", "small"]
    for (label, (learned, planner)), steps in zip(table.items(), (1, 2), strict=True):
        assert (learned["policy"], learned["house_set"]) == (label, "test 8x8")
        assert {house["T_90"] for house in learned["houses"]} == {steps}
        assert planner["policy"] == "nearest_unknown"
    same = {"large": [run_entries("a", 20, 1)], "also": [run_entries("b", 20, 2)]}
    assert [rows["also"][0]["house_set"] for rows in tables_of(same)] == ["test", "test 8x8"]
    other = {label: [run_entries(label, rows, 1)[:3]] for label, rows in (("a", 5), ("b", 6))}
    assert tables_of(other) == []
