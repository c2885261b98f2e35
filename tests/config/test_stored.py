"""The config of a stranger's run: nothing in it says where this machine writes or reports."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf import OmegaConf

from marl_clean.config import stored
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import check_same_run, compose_for_policy, compose_for_training
from marl_clean.errors import BadInput

THEIRS: dict[str, Any] = {
    "mlflow": {
        "_target_": "marl_clean.logger.mlflow.MlFlow",
        "tracking_uri": "http://elsewhere.example",
        "experiment": "theirs",
    },
    "wandb": {
        "_target_": "marl_clean.logger.wandb.Wandb",
        "project": "theirs",
        "offline": False,
    },
}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run with another user's `out` and loggers, and weights that are not looked at."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(stored, "weights_sha256", lambda folder: "0" * 64)
    folder = Path("runs/theirs")
    folder.mkdir(parents=True)
    plain = OmegaConf.to_container(compose_config(["name=theirs", f"out={tmp_path / 'mine'}"]))
    assert isinstance(plain, dict)
    (folder / "config.yaml").write_text(yaml.safe_dump({**plain, "logger": THEIRS}))
    return folder


def test_out_of_a_stored_config_is_not_used(run: Path) -> None:
    assert compose_for_policy(["checkpoint=theirs"]).out is None
    assert compose_for_training(["checkpoint=theirs"]).out is None
    assert compose_for_policy(["checkpoint=theirs", "out=here.json"]).out == "here.json"


def test_loggers_of_a_stored_config_have_the_settings_of_their_yaml(run: Path) -> None:
    logger = compose_for_training(["checkpoint=theirs"]).logger
    assert (logger.mlflow.tracking_uri, logger.mlflow.experiment) == (None, "marl_clean")
    assert (logger.wandb.project, logger.wandb.offline) == ("marl_clean", True)
    given = compose_for_training(["checkpoint=theirs", "logger.mlflow.tracking_uri=sqlite:///a"])
    assert given.logger.mlflow.tracking_uri == "sqlite:///a"


def test_neither_is_part_of_the_hash(run: Path) -> None:
    own = compose_config(["name=theirs"])
    assert config_hash(compose_for_policy(["checkpoint=theirs"])) == config_hash(own)
    check_same_run(own, run)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed: 2020-01-01", 'seed: must be a whole number.*not "2020-01-01"'),
        ("seed: !!set {a}", "not plain yaml"),
        ("checkpoint: '???'", "values written out"),
        ("'${oc.env:HOME}': 1", "values written out"),
        ('"\\e[31m": 1', r"\\x1b\[31m: no such key"),
    ],
)
def test_what_is_no_setting_is_one_line(run: Path, text: str, words: str) -> None:
    path = run / "config.yaml"
    plain = yaml.safe_load(path.read_text())
    plain.pop(text.partition(":")[0], None)
    path.write_text(f"{yaml.safe_dump(plain)}\n{text}\n")
    with pytest.raises(BadInput, match=words) as caught:
        compose_for_policy(["checkpoint=theirs"])
    assert str(caught.value).isprintable()
