"""NaN and infinity planted in trainings stop them before the disk; a weaker guard is caught."""

from typing import Any

import pytest
import torch

from marl_clean.storage import checkpoint
from marl_clean.trainer import _finite
from tests.agent.parts import LEARNERS
from tests.reliability import numbers
from tests.reliability.number_places import PLACES

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread", "unchecked")]
SEEN_BY_THE_LOSS = numbers.Trial("iql", "the loss", "learn", 1, "each block", torch.nan)
MISSED_BY_THE_LOSS = [
    numbers.Trial("iql", "a weight", "measure", 3, "the end", torch.nan),
    numbers.Trial("pqn", "a second moment", "measure", 3, "each block", torch.inf),
    numbers.Trial("central_dqn", "an observation", "collect", 3, "the end", torch.nan),
    numbers.Trial("mappo", "a validation measure", "measure", 2, "the end", torch.inf),
]


@pytest.mark.long
def test_a_number_that_is_not_finite_stops_a_run_before_the_disk() -> None:
    trials = numbers.drawn(len(PLACES))
    assert {trial.place for trial in trials} == {*PLACES}
    assert {trial.learner for trial in trials} == {*LEARNERS}
    assert numbers.failures(trials) == []


@pytest.mark.long
def test_a_guard_that_looks_at_the_loss_alone_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    everything = _finite.not_finite

    def loss_alone(tree: Any) -> list[str]:
        measures = tree.get("measures") if isinstance(tree, dict) else None
        return everything({"measures": {"loss": measures["loss"]}} if measures else {})

    monkeypatch.setattr(_finite, "not_finite", loss_alone)
    monkeypatch.setattr(checkpoint, "not_finite", lambda tree: [])
    failed = "\n".join(numbers.failures([SEEN_BY_THE_LOSS, *MISSED_BY_THE_LOSS]))
    for trial in MISSED_BY_THE_LOSS:
        assert str(trial) in failed
    assert str(SEEN_BY_THE_LOSS) not in failed
    assert "safetensors: " in failed  # and the disk holds it
