"""The comparisons: every row composes, one is trained and drawn, wrong settings start nothing."""

import io
import re

import pytest
from rich.console import Console

from marl_clean.commands import comparison, train
from marl_clean.commands.comparison import COMPARISONS, jobs_of
from marl_clean.config.config_hash import config_hash
from marl_clean.errors import BadInput

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


@pytest.mark.parametrize("name", COMPARISONS)
def test_the_rows_of_a_comparison_are_different_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    jobs = jobs_of(name, ["budget=smoke", "seed=0,1"])
    assert list(jobs) == list(COMPARISONS[name].rows)
    hashes = [config_hash(config) for configs in jobs.values() for config in configs]
    assert len(set(hashes)) == len(hashes) == 2 * len(jobs)
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


@pytest.mark.slow
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
    assert png.read_bytes()[1:4] == b"PNG"

    trained = []
    monkeypatch.setattr(train, "measure_all", lambda *arguments: trained.append(arguments))
    assert comparison.main("sensors", [*TINY, "seed=0,1"], console) == [svg, png]
    assert trained == []
