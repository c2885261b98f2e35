"""The same call after a run's last weights: what a kill left is cleared, what is whole is used."""

from pathlib import Path

import pytest
import torch

from marl_clean.storage.checkpoint import AllDamaged, Checkpoints
from marl_clean.trainer._outcome import Outcome, earlier_outcome

BEST = {"T_100": 91.5}


def ended(folder: Path, *kinds: str) -> Checkpoints:
    """A run's checkpoints of these kinds, of 8 frames, and a best one of 4."""
    checkpoints = Checkpoints(folder)
    checkpoints.save("best", 4, {"x": torch.ones(3)}, BEST)
    for kind in kinds:
        notes = {"updates": 5, "best": {"frames": 4, **BEST}}
        checkpoints.save(kind, 8, {"x": torch.ones(3)}, notes)
    return checkpoints


def damage(checkpoints: Checkpoints, kind: str) -> None:
    [path] = checkpoints.folder.glob(f"{kind}-*/tensors.safetensors")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def kinds_in(checkpoints: Checkpoints) -> list[str]:
    return sorted(path.name.partition("-0")[0] for path in checkpoints.folder.iterdir())


def test_states_and_leftovers_of_a_kill_at_the_end_are_cleared(tmp_path: Path) -> None:
    checkpoints = ended(tmp_path, "state", "final")
    (tmp_path / ".partial-state-000000000004").mkdir()
    assert earlier_outcome(checkpoints) == Outcome(8, 5, {"frames": 4, **BEST}, was_finished=True)
    assert kinds_in(checkpoints) == ["best", "final"]


def test_a_run_without_last_weights_is_not_finished(tmp_path: Path) -> None:
    checkpoints = ended(tmp_path, "state")
    assert earlier_outcome(checkpoints) is None
    assert kinds_in(checkpoints) == ["best", "state"]


@pytest.mark.parametrize(
    ("kinds", "said", "outcome"),
    [
        (("final",), "the best weights are whole", Outcome(8, None, {"frames": 4, **BEST}, True)),
        (("state", "final"), "made again from the newest state", None),
    ],
)
def test_damaged_last_weights_are_passed_over_in_one_line(
    kinds: tuple[str, ...],
    said: str,
    outcome: Outcome | None,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    checkpoints = ended(tmp_path, *kinds)
    damage(checkpoints, "final")
    before = kinds_in(checkpoints)
    assert earlier_outcome(checkpoints) == outcome
    [line] = caplog.messages
    assert "final-000000000008 is damaged" in line and said in line
    assert kinds_in(checkpoints) == before


def test_damaged_last_and_best_weights_are_refused(tmp_path: Path) -> None:
    checkpoints = ended(tmp_path, "final")
    for kind in ("best", "final"):
        damage(checkpoints, kind)
    with pytest.raises(AllDamaged, match="every best checkpoint is damaged"):
        earlier_outcome(checkpoints)
