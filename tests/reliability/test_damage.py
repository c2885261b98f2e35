"""Damaged checkpoints are noticed, hostile ones refused; `tests.reliability.damage` tries more."""

from pathlib import Path

import pytest

from marl_clean.errors import BadInput
from marl_clean.storage import checkpoint
from tests.families import family
from tests.reliability.damage import HOSTILE, check_damage, read_hostile


@pytest.mark.slow
def test_damage_is_noticed_and_the_one_before_is_taken() -> None:
    check_damage(trials=20)


def test_the_harness_sees_a_reader_that_does_not_verify(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "verify", lambda path: {})
    with pytest.raises(AssertionError, match="is not noticed"):
        check_damage(trials=10, kinds=("flip",))


@family("name", list(HOSTILE), fast=8)
def test_a_hostile_checkpoint_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="every best checkpoint is damaged"):
        read_hostile(name, tmp_path)
