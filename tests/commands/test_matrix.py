"""The matrix of channels: every run over every channel, one row a training channel."""

import json

import pytest
from omegaconf import OmegaConf

from marl_clean import cli
from marl_clean.commands import train
from marl_clean.commands.matrix import Trained, section_of, trained_over
from marl_clean.config.compose import compose_config
from tests.reliability import short_jobs
from tests.report.reading import origin_of

pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")

TINY = [
    "budget=smoke",
    "train_houses=8",
    "house.rows=[6,6]",
    "house.cols=[6,6]",
    "observation.view_size=5",
    "env.num_envs=16",
    "env.max_steps=20",
    "trainer.total_frames=256",
    "trainer.frames_per_batch=128",
    "trainer.start_frames=0",
    "trainer.batch_frames=32",
    "trainer.replay_ratio=0.25",
    "evaluation.houses=3",
    "evaluation.plans=[]",
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    place = tmp_path_factory.mktemp("matrix")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(train, "draw", short_jobs.draw)
        swept = ["channel=perfect,delayed", "comm=plan", "seed=0,1", "name=x"]
        assert cli.main(["train", "-m", "hydra/launcher=basic", *TINY, *swept]) == 0
        assert cli.main(["train", *TINY, "comm=none", "name=silent"]) == 0
    return place


@pytest.mark.long
def test_a_row_a_training_channel_and_a_column_a_test_channel(runs, monkeypatch, capsys):
    monkeypatch.chdir(runs)
    folders = sorted(str(path) for path in (runs / "runs" / "x").iterdir())
    assert cli.main(["matrix", *folders, str(runs / "nothing"), "--out", "m.json"]) == 0
    cells = json.loads((runs / "m.json").read_text())
    names = {cell["policy"] for cell in cells}
    rows, columns = ("channel=perfect", "channel=delayed"), ("perfect", "delayed")
    assert names == {f"{row} | {column} (2 seeds)" for row in rows for column in columns}
    assert all(len(cell["houses"]) == 6 for cell in cells)
    source, hashes = origin_of(runs / "runs/figures/matrix.png")
    # A run's config over the other channel is that of the run trained over it.
    assert source.startswith("marl-clean matrix ") and len(hashes) == 4
    # What it was trained over is measured as training measured it.
    [home] = [c for c in cells if c["policy"].startswith("channel=delayed | delayed")]
    stored = []
    for folder in folders:
        entries = json.loads((runs / "runs/x" / folder / "evaluation.json").read_text())
        config = (runs / "runs/x" / folder / "config.yaml").read_text()
        stored += entries[0]["houses"] if "Delayed" in config else []
    assert sorted(map(str, home["houses"])) == sorted(map(str, stored))


@pytest.mark.long
def test_channels_to_measure_over_can_be_chosen(runs, monkeypatch):
    monkeypatch.chdir(runs)
    folder = str(next((runs / "runs" / "x").iterdir()))
    channels = ["--channel", "lossy(loss=1.0)", "--channel", "quantised(bits=2,limit=1.5),noisy"]
    assert cli.main(["matrix", folder, *channels, "--houses", "2", "--out", "n.json"]) == 0
    cells = json.loads((runs / "n.json").read_text())
    assert [cell["policy"] for cell in cells] == [f"run | {text}" for text in channels[1::2]]
    assert all(len(cell["houses"]) == 2 for cell in cells)


@pytest.mark.slow
def test_the_same_channels_in_another_order_are_another_column():
    stacks = ["lossy,delayed", "delayed,lossy", "lossy,delayed"]
    configs = [compose_config([f"channel=[{stack}]"]) for stack in stacks]
    trained = {str(i): Trained(OmegaConf.to_container(c)) for i, c in enumerate(configs)}
    assert list(trained_over(trained)) == ["lossy+delayed", "delayed+lossy"]


def test_stacks_are_read_with_their_settings():
    section = section_of("quantised(bits=2,limit=1.5),lossy")
    assert list(section) == ["quantised", "lossy"]
    assert (section.quantised.bits, section.quantised.limit) == (2, 1.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "no run among nowhere"),
        (["{run}", "--channel", "lossi"], "channel=[lossi]: no such level; did you mean lossy?"),
        (["{run}", "--channel", "lossy(loss=2)"], "channel.lossy.loss: must be a number"),
        (["{run}", "--channel", "lossy(los=2)"], "channel.lossy.los: no such key"),
        (["{silent}"], "its robots send no messages"),
    ],
)
def test_wrong_input_is_one_line(runs, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(runs)
    known = {"run": str(next((runs / "runs" / "x").iterdir())), "silent": "silent"}
    assert cli.main(["matrix", *(text.format(**known) for text in arguments)]) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]
