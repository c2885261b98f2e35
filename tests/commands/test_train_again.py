"""The same command after a run is finished: what is whole is used, what is torn is made again."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from marl_clean import cli
from marl_clean.commands import train
from tests.reliability.full_disk import limited_to

RUN = (
    "train +experiment=quick name=run trainer.total_frames=128 trainer.eval_interval_frames=128"
    " trainer.log_interval_frames=128 trainer.start_frames=64 evaluation.houses=2"
    " evaluation.plans=[] train_houses=8 logger=[csv] env.max_steps=20"
).split()


@pytest.mark.long
@pytest.mark.usefixtures("unchecked")
def test_a_torn_evaluation_is_measured_again_and_another_version_is_left(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "draw", lambda config, folder: None)
    assert cli.main(RUN) == 0
    result = Path("runs/run/evaluation.json")
    whole = result.read_bytes()
    for torn in (whole[: len(whole) // 2], b"", whole.replace(b'"T_100"', b'"T_1OO"')):
        result.write_bytes(torn)
        caplog.clear()
        assert cli.main(RUN) == 0
        [line] = [line for line in caplog.messages if "evaluation.json" in line]
        assert line.endswith("measured again")
        assert result.read_bytes() == whole
    entries = json.loads(whole)
    entries[0]["world"] = -1
    result.write_text(json.dumps(entries))
    assert cli.main(RUN) == cli.BAD_INPUT
    assert "world version -1" in capsys.readouterr().err
    assert json.loads(result.read_text())[0]["world"] == -1


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder around a run that is finished, with all its pictures."""
    place = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert cli.main(RUN) == 0
    yield place


def contents(run: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(run)): path.read_bytes()
        for path in run.rglob("*")
        if path.is_file() and path.name not in (".lock", "run.json")
    }


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_the_same_command_goes_on_with_what_is_whole(
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    shutil.copytree(finished / "runs", tmp_path / "runs")
    monkeypatch.chdir(tmp_path)
    run = Path("runs/run")
    whole = contents(run)
    [final] = run.glob("checkpoints/final-*")
    shutil.copytree(final, final.with_name("state-000000000064"))  # a kill left them behind
    (run / ".partial-metrics.csv").write_text("frames")
    assert cli.main(RUN) == 0
    assert caplog.messages == []
    assert contents(run) == whole

    def torn(name: str, content: bytes) -> str:
        (run / name).write_bytes(content)
        return name

    tensors = bytearray((final / "tensors.safetensors").read_bytes())
    tensors[-1] ^= 1
    passed_over = [
        torn("config.yaml", whole["config.yaml"][:500]),
        torn(str(final.relative_to(run) / "tensors.safetensors"), bytes(tensors)),
        torn("metrics.csv", whole["metrics.csv"].replace(b"frames,", b"fr\0mes,")),
        torn("replay.gif", b""),
    ]
    assert cli.main(RUN) == 0
    assert len(caplog.messages) == len(passed_over)
    for line, name in zip(caplog.messages, passed_over, strict=True):
        assert name.removesuffix("/tensors.safetensors") in line and "\n" not in line
    left = contents(run)
    for name in passed_over[1:3]:  # a finished run cannot make them again
        assert left.pop(name) != whole[name]
    assert left == {name: whole[name] for name in left}
    assert len(left) == len(whole) - 2


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("size", [300, 8_000])
def test_a_full_disk_is_one_line_and_exit_2(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with limited_to(size):
        assert cli.main(RUN) == cli.BAD_INPUT
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("marl-clean: ") and said[-1].endswith("File too large")
    assert not any("Traceback" in line for line in said)
