"""What was measured of a policy, with what a comparison needs to know of its training.

It comes from a run's folder, or from an export of a comparison (tidy.py, marl_eval.py).
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from marl_clean.errors import BadInput
from marl_clean.evaluation.records import (
    SCHEMA,
    WORLD,
    Entry,
    House,
    entry_fault,
    house_fault,
    summarise,
)
from marl_clean.storage.reading import read_bytes

LARGEST_BYTES = 128 << 20  # of an export, as of a thousand runs in 200 houses
MOST_VALUES = 8_000_000
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Measured:
    """One policy on one set of houses.

    Attributes:
        world: a hash of the rules, the houses and the starts: what is comparable shares it.
        setting: a hash of the config without its seed; None for a planner.
        seed: of the run; None for a planner.
        entry: the entry of its evaluation.json.
        label: the row's name in the comparison that was exported; None from a run's folder.
        silent: whether it is a setting without communication.
        parameters: of the network.
        config: of the run; None from an export.
        folder: of the run; None from an export.
    """

    world: str
    setting: str | None
    seed: int | None
    entry: Entry
    label: str | None = None
    silent: bool = False
    parameters: int | None = None
    config: Mapping[str, Any] | None = field(default=None, repr=False)
    folder: Path | None = None


def read_text(path: Path) -> str:
    """The text of an export, which need not be trusted. Raises BadInput where it is none."""
    content = read_bytes(path, LARGEST_BYTES)
    try:
        text = content.decode("utf-8")
    except ValueError as error:
        raise BadInput(f"{path}: is not text; an export of `compare --export` is valid") from error
    if not text.strip():
        raise BadInput(f"{path}: is empty; an export of `compare --export` is valid")
    return text


def versions_fit(path: Path, policy: str, schema: Any, rules: Any) -> bool:
    """Whether an exported entry is of this version; what is not is logged in one line."""
    if schema == SCHEMA and rules in (WORLD, None):
        return True
    log.warning(
        "left out: %s: %s has schema %s and world version %s, only %s and %s are valid",
        *(path, policy, schema, rules, SCHEMA, WORLD),
    )
    return False


def entry_of(path: Path, fields: Mapping[str, Any], houses: Sequence[House]) -> Entry:
    """An entry as evaluation.json has it, its summary computed anew.

    Raises BadInput where its houses cannot be shown and pooled with others'.
    """
    policy = str(fields["policy"])[:80]
    if (fault := house_fault(houses)) is not None:
        raise BadInput(f"{path}: {policy}: {fault}; half-written, or no export")
    entry = {**fields, "houses": [dict(house) for house in houses], "summary": summarise([houses])}
    if (fault := entry_fault(entry)) is not None:
        raise BadInput(f"{path}: {policy}: {fault}; half-written, or no export")
    return entry


def check_exported(path: Path, measured: Iterable[Measured]) -> None:
    """Raises BadInput where an entry is not described as exported, or two claim the same run."""
    seen = set()
    for item in measured:
        numbers = all(value is None or type(value) is int for value in (item.seed, item.parameters))
        if not (numbers and isinstance(item.label, str) and item.label.isprintable()):
            raise BadInput(f"{path}: {item.entry['policy']}: its row, seed or size is not exported")
        key = (item.world, item.setting, item.seed, item.entry["policy"])
        if key in seen:
            raise BadInput(f"{path}: {item.entry['policy']}: stands there twice")
        seen.add(key)
