"""What became of a training."""

import logging
from dataclasses import dataclass
from typing import Any

from marl_clean.storage import manifest
from marl_clean.storage.checkpoint import AllDamaged, Checkpoints

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        frames, updates: collected and done in all; None where no undamaged file tells.
        best: frames and measures of the weights chosen on validation houses; None without any.
        was_finished: nothing was left to do.
    """

    frames: int
    updates: int | None
    best: dict[str, Any] | None
    was_finished: bool


def earlier_outcome(checkpoints: Checkpoints) -> Outcome | None:
    """Return what became of a run that is finished; None where something is left to do.

    States that a kill at the end has left are removed. Where the last weights are damaged, the run
    makes them again from a state; without one it counts as finished if its best weights are whole.

    Raises:
        AllDamaged: nothing to go on with is whole.
    """
    try:
        final = checkpoints.newest("final")
    except AllDamaged as error:
        return _without_final(checkpoints, error)
    if final is None:
        return None
    checkpoints.remove("state")
    return Outcome(final.frames, final.notes["updates"], final.notes["best"], was_finished=True)


def _without_final(checkpoints: Checkpoints, error: AllDamaged) -> Outcome | None:
    newest = manifest.paths(checkpoints.folder, "final")[0]
    if manifest.paths(checkpoints.folder, "state"):
        log.warning("%s is damaged: made again from the newest state", newest)
        return None
    best = checkpoints.newest("best")
    if best is None:
        raise error
    log.warning("%s is damaged: the best weights are whole, and are what is used", newest)
    frames = int(newest.name.rpartition("-")[2])
    return Outcome(frames, None, {"frames": best.frames, **best.notes}, was_finished=True)
