"""The same command after a run is finished: what is whole is used, what is torn is made again."""

import json
from pathlib import Path

import pytest

from marl_clean import cli
from marl_clean.commands import train

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
