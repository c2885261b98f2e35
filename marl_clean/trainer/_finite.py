"""NaN and infinity end a training before they are logged or saved, in one line that names them."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from marl_clean import keys
from marl_clean.learning.agent import Agent
from marl_clean.storage.finite import Diverged, not_finite

PAID = "/".join(("next", *keys.REWARD))
SAID = "is NaN or infinite; nothing of it is saved"
HINT = "; a smaller agent.lr may help"


def check_numbers(tree: Any, frames: int) -> None:
    """Raise Diverged where a number of a tree, such as a block of `frames`, is not finite.

    A reward is named before what follows from it.
    """
    if bad := not_finite(tree):
        raise Diverged(f"frame {frames}: {'a reward' if PAID in bad else bad[0]} {SAID}")


def check_learner(
    agent: Agent, updates: int, frames: int, measures: Mapping[str, Tensor] | None = None
) -> None:
    """Raise Diverged where a learner's state, or a measure of its last updates, is not finite.

    `measures` hold a number for each of the updates after `updates`. The first that is not finite
    is named, else the part of the state. A smaller step size is advised only where steps have been
    taken before.
    """
    measures = measures or {}
    bad = not_finite({"measures": measures, "agent": agent.state_dict()})
    if not bad:
        return
    first = [(index, name) for name, values in measures.items() for index in bad_places(values)]
    if first:
        index, name = min(first, key=lambda place: place[0])
        before, update = updates + index, updates + index + 1
    else:
        name = bad[0].replace("agent/network/", "weight ")
        before = update = updates + len(next(iter(measures.values()), ()))
    hint = HINT if before and "optimiser/" not in name else ""
    raise Diverged(f"update {update}, frame {frames}: {name} {SAID}{hint}")


def bad_places(values: Tensor) -> Sequence[int]:
    """Return which of the values are not finite."""
    return values.isfinite().logical_not().nonzero().flatten().tolist()
