"""Wrong settings of every kind are refused; `tests.reliability.settings` tries thousands."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from marl_clean.commands import checks
from marl_clean.config import compose
from tests.reliability.settings import check, fault, generated
from tests.reliability.short_jobs import train_by

TRIALS = 40


@pytest.mark.long
def test_wrong_settings_are_refused_in_a_line_before_torch_is_imported(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.reliability.settings", "--trials", str(TRIALS)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.startswith(f"{TRIALS} wrong commands: 0 accepted"), done.stderr


@pytest.mark.slow
def test_every_level_has_settings_that_are_wrong_by_each_of_their_keys() -> None:
    named = {key for _, key in generated()}
    assert {"seed", "evaluation.epsilon", "comm.ground.missing", "channel.lossy.loss"} <= named
    assert len(set(generated())) > 1000


def test_a_check_that_lets_everything_pass_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    train_by(monkeypatch, main=lambda *arguments: None)
    monkeypatch.setattr(compose, "_problems", lambda plain: iter(()))
    assert "agent.lr=1e400: 0" in fault("train agent.lr=1e400", "agent.lr")


def test_a_check_that_fails_in_a_traceback_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def planted(config: Any) -> None:
        raise TypeError("planted")

    monkeypatch.setattr(checks, "CHECKS", [planted])
    with pytest.raises(AssertionError, match=r"1 of 1:\ntrain .* traceback: TypeError"):
        check(0, {"train env.n_agents=99": "env.n_agents"})
