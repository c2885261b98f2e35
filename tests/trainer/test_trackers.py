"""What Weights & Biases and MLflow hold after a run, read by their own means."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from marl_clean import BadInput, cli
from marl_clean.commands import checks
from marl_clean.config.compose import compose_config

BLOCK = 2**15
RUN = (
    "train +experiment=quick name=run trainer.total_frames=256 trainer.eval_interval_frames=256"
    " trainer.log_interval_frames=128 trainer.start_frames=64 evaluation.houses=2"
    " evaluation.plans=[] train_houses=8 env.max_steps=20"
)


def trained(folder: Path, monkeypatch: pytest.MonkeyPatch, logger: str) -> Path:
    monkeypatch.chdir(folder)
    assert cli.main([*RUN.split(), f"logger=[csv,{logger}]"]) == 0
    return folder / "runs" / "run"


def rows(run: Path) -> dict[int, dict[str, str]]:
    header, *lines = (run / "metrics.csv").read_text().splitlines()
    cells = (dict(zip(header.split(","), line.split(","), strict=True)) for line in lines)
    return {int(row.pop("frames")): row for row in cells}


def records_of(path: Path) -> Iterator[bytes]:
    """Read a log in LevelDB's format, as wandb writes it behind 7 bytes of its own."""
    data, place, record = path.read_bytes(), 7, b""
    while place < len(data):
        left = BLOCK - place % BLOCK
        if left < 7:  # no header fits into the rest of a block
            place += left
            continue
        size, kind = int.from_bytes(data[place + 4 : place + 6], "little"), data[place + 6]
        record += data[place + 7 : place + 7 + size]
        place += 7 + size
        if kind in (1, 4):  # whole, or the last part
            yield record
            record = b""


def values_in(path: Path) -> dict[str, str]:
    """What a file of wandb's has logged, as JSON by name."""
    from wandb.proto import wandb_internal_pb2

    values = {}
    for data in records_of(path):
        record = wandb_internal_pb2.Record()
        record.ParseFromString(data)
        for item in record.history.item:
            values[item.key or ".".join(item.nested_key)] = item.value_json
    return values


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the packages' own dependencies
def test_mlflow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mlflow = pytest.importorskip("mlflow")
    run = trained(tmp_path, monkeypatch, "mlflow")
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{run / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("marl_clean")
    (stored,) = client.search_runs([experiment.experiment_id])
    assert stored.info.run_name == "run" and stored.info.status == "FINISHED"
    assert stored.data.params["env.n_agents"] == "2"
    assert stored.data.params["agent.gamma"]
    copy = client.download_artifacts(stored.info.run_id, "replay.gif", str(tmp_path))
    assert Path(copy).read_bytes() == (run / "replay.gif").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "replay.gif"}
    for frames, row in rows(run).items():
        for name in (name for name, value in row.items() if value):
            history = client.get_metric_history(stored.info.run_id, name)
            values = {point.step: point.value for point in history}
            assert values[frames] == pytest.approx(float(row[name])), name


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the packages' own dependencies
def test_wandb_without_a_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    from wandb.proto import wandb_internal_pb2

    run = trained(tmp_path, monkeypatch, "wandb")
    path, shown = sorted((run / "wandb").glob("offline-run-*/*.wandb"))
    assert path.name == shown.name  # the same id
    logged_last = values_in(shown)
    assert logged_last["replay._type"] == '"video-file"'
    gif = shown.parent / "files" / json.loads(logged_last["replay.path"])
    assert gif.read_bytes() == (run / "replay.gif").read_bytes()
    logged: dict[int, dict[str, Any]] = {}
    settings: set[str] = set()
    for data in records_of(path):
        record = wandb_internal_pb2.Record()
        record.ParseFromString(data)
        if record.HasField("history"):
            row = {item.key or item.nested_key[0]: item.value_json for item in record.history.item}
            logged.setdefault(int(row["_step"]), {}).update(row)
        for update in (*record.run.config.update, *record.config.update):
            settings.add(update.key or update.nested_key[0])
    assert {"env", "agent", "comm"} <= settings
    for frames, expected in rows(run).items():
        for name in (name for name, value in expected.items() if value):
            assert float(logged[frames][name]) == pytest.approx(float(expected[name])), name


@pytest.mark.long
def test_tensorboard_plays_the_replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = trained(tmp_path, monkeypatch, "tensorboard")
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    assert events.Tags()["images"] == ["replay"] and "validation/T_90" in events.Tags()["scalars"]
    (event,) = events.Images("replay")
    assert event.step == max(rows(run))
    assert event.encoded_image_string == (run / "replay.gif").read_bytes()
    with Image.open(run / "replay.gif") as picture:
        assert (event.width, event.height) == picture.size


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_resumed_run_keeps_its_id_and_a_new_one_gets_another(tmp_path: Path) -> None:
    pytest.importorskip("wandb")
    from marl_clean.logger.wandb import Wandb

    ids = []
    for frames in (0, 128, 0):
        logger = Wandb(tmp_path)
        logger.resume(frames)
        assert logger.writer is not None
        ids.append(logger.writer.experiment.id)
        logger.close()
    assert ids[0] == ids[1] != ids[2]


@pytest.mark.parametrize("level", ["wandb", "mlflow"])
def test_a_tracker_that_is_not_installed_is_one_line(
    level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "is_installed", lambda name: name != level)
    with pytest.raises(BadInput, match=f"logger={level}: {level} is not installed; pip install"):
        checks.check_loggers(compose_config([f"logger=[csv,{level}]"]))
