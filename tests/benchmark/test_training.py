"""The rows of what training costs, on trainings so small that their times say nothing."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from marl_clean.commands import _benchmark_training as training
from marl_clean.commands._benchmark_training import MIB, PARTS, Session, Training

SMALL = [
    "env.num_envs=8",
    "env.max_steps=20",
    "train_houses=8",
    "trainer.frames_per_batch=64",
    "evaluation.houses=2",
]
PRESETS = {
    "any_house": [*SMALL, "trainer.imitate=null", "trainer.minibatch_frames=64"],
    "approach_2_frontier": [*SMALL, "trainer.start_frames=0", "trainer.buffer_frames=300"],
}


def overrides(name: str) -> list[str]:
    return [f"+experiment={name}", *PRESETS[name]]


def shown(costs: list[Training]) -> str:
    console = Console(width=80, file=StringIO())
    console.print(training.table_of_training(costs))
    return console.file.getvalue()


@pytest.mark.long
def test_presets_are_timed_interleaved_and_their_parts_add_up(monkeypatch) -> None:
    monkeypatch.setattr(training, "PRESETS", PRESETS)
    monkeypatch.setattr(training, "peak_memory", lambda overrides: 300 * MIB)
    costs = training.costs_of_training(rounds=2, slice_seconds=0.0)
    assert [cost.what for cost in costs] == list(PRESETS)
    assert costs[1].ratio == 1.0
    for cost in costs:
        assert cost.robot_steps_per_second == pytest.approx(2 * cost.frames_per_second)
        assert list(cost.shares) == list(PARTS)
        assert sum(cost.shares.values()) == pytest.approx(1.0)
        assert all(share > 0 for share in cost.shares.values())
    text = shown(costs)
    assert "…" not in text
    assert all(word in text for word in ("any_house", ">= 5.00", "time in learning", "300"))


def test_a_replay_is_filled(tmp_path: Path) -> None:
    session = Session(overrides("approach_2_frontier"), tmp_path)
    session.run(0.0)
    session.fill()
    assert len(session.loop.replay) == 300


@pytest.mark.long
def test_memory_is_that_of_a_process_of_its_own() -> None:
    held = bytearray(2**31)
    held[::4096] = bytes(2**19)  # every page is in use: the asking process has more
    assert 100 * MIB < training.peak_memory(overrides("any_house")) < 1500 * MIB < len(held)
