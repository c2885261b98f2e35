"""Signals end a training in time, with its state saved; `tests.reliability.signals` sends more."""

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from marl_clean.commands._signals import handled
from marl_clean.trainer._interrupts import Interrupts
from marl_clean.trainer._owed import Learning, Owed
from marl_clean.trainer.on_policy import OnPolicyLoop
from tests.reliability.signals import Broken, check, check_starts, interrupt
from tests.trainer.test_resume import train

PATIENCE = 60.0  # seconds: how soon they end is measured by the harness alone, on an idle machine
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread", "unchecked")]


@pytest.mark.long
def test_trainings_that_get_a_signal_at_any_moment_go_on_exactly() -> None:
    assert check(4, within=PATIENCE).startswith("4 signals to trainings")


@pytest.mark.long
def test_a_process_that_gets_a_signal_while_it_starts_ends_by_it() -> None:
    assert check_starts(4, seconds=1.5, within=PATIENCE).startswith("4 signals in the first 1.5 s")


def test_a_signal_whose_exception_a_library_loses_stops_the_training_all_the_same() -> None:
    with handled():
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        with Interrupts() as interrupts:
            assert interrupts.signal == signal.SIGINT
    with handled(), Interrupts() as interrupts:
        assert interrupts.signal is None


def signal_at_update(monkeypatch: pytest.MonkeyPatch, nth: int) -> None:
    """Let a fork of this process send itself SIGTERM in the `nth` update."""
    update, here, made = OnPolicyLoop.update, os.getpid(), []

    def signalling(*arguments: Any) -> Any:
        if os.getpid() != here:
            made.append(1)
            if len(made) == nth:
                os.kill(os.getpid(), signal.SIGTERM)
        return update(*arguments)

    monkeypatch.setattr(OnPolicyLoop, "update", signalling)


@pytest.mark.long
def test_a_signal_that_is_looked_at_only_between_blocks_is_caught(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def deaf(loop: Learning, owed: Owed) -> None:
        loop.count([loop.update(owed) for _ in range(owed.num)])

    signal_at_update(monkeypatch, 1)
    monkeypatch.setattr(Learning, "make", deaf)
    with pytest.raises(Broken, match=r"has not ended 5\.0 s after"):
        interrupt(tmp_path, "on policy", signal.SIGTERM, None, slow=True)


@pytest.mark.long
def test_a_state_in_the_middle_of_a_block_that_forgets_some_of_it_is_caught(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(tmp_path / "on policy", "on policy")
    signal_at_update(monkeypatch, 2)
    place = tmp_path / "faithful"
    place.mkdir()
    (place / "on policy").symlink_to(tmp_path / "on policy")
    assert interrupt(place, "on policy", signal.SIGTERM, None, slow=False, within=60)[1]

    whole = Owed.of
    monkeypatch.setattr(Owed, "of", lambda state, device: whole({**state, "num": 1}, device))
    with pytest.raises(AssertionError):
        interrupt(tmp_path, "on policy", signal.SIGTERM, None, slow=False, within=60)
