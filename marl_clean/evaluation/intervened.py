"""What `evaluate intervention=...` wrote: a run with its messages intact, and changed.

Nothing here needs torch.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, FiniteFloat, TypeAdapter, ValidationError

from marl_clean.evaluation.records import LARGEST_BYTES, Entry, Torn, read_entries
from marl_clean.storage.reading import read_bytes

MARK = " | "  # between a policy's name and what changed its messages
REPLACED, LISTENED = ("zero", "shuffle"), ("moved", "switched", "kl")
CAPTION = (
    "Robots that hear a message. moved: mean |Q' - Q| over the spread of Q between\n"
    "actions (a shift of all alike changes none); switched: the best action differs;\n"
    "kl, cic: nats, softmax at temperature {temperature}; cic: information\n"
    "between message and action, over {messages} messages."
)


class _Mean(BaseModel, strict=True):
    mean: FiniteFloat | None
    ci95: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None


@dataclass(frozen=True)
class Intervened:
    """A run's entries on the same houses: untouched, and by the name of each intervention."""

    untouched: Entry
    changed: Mapping[str, Entry]


def read_intervened(path: Path) -> Intervened | None:
    """The entries of interventions in an evaluation.json, which need not be trusted.

    None where it has none, or there is no such file. Raises BadInput where it is no
    evaluation.json that can be shown.
    """
    if not path.is_file() or b'"change"' not in read_bytes(path, LARGEST_BYTES):
        return None
    entries = read_entries(path)
    untouched = next((entry for entry in entries if "listening" in entry), None)
    changed = {name_of(entry): entry for entry in entries if "change" in entry}
    if untouched is None or not changed:
        return None
    if fault := _fault(untouched["listening"]):
        raise Torn(f"{path}: listening: {fault}; an evaluation.json is valid")
    if any(len(entry["houses"]) != len(untouched["houses"]) for entry in changed.values()):
        raise Torn(f"{path}: interventions on other houses; an evaluation.json is valid")
    return Intervened(untouched, changed)


def name_of(entry: Entry) -> str:
    """What changed the messages of an entry's policy."""
    return str(entry["policy"].rpartition(MARK)[2])


def listening_cells(listening: Mapping[str, Any]) -> list[list[str]]:
    """The cells of the table of how far robots listen, titles first."""
    lines = [["replaced by", *LISTENED, "cic"]]
    for name in REPLACED:
        cells = [_cell(listening[f"{name}_{column}"]) for column in LISTENED]
        lines.append([name, *cells, _cell(listening["cic"]) if name == REPLACED[-1] else ""])
    return lines


def _cell(estimated: Mapping[str, Any]) -> str:
    if estimated["mean"] is None:
        return "-"
    low, high = estimated["ci95"]
    return f"{estimated['mean']:.3f} [{low:.3f}, {high:.3f}]"


def _fault(listening: Any) -> str | None:
    if not isinstance(listening, dict) or not {"temperature", "messages"} <= set(listening):
        return "has no temperature and messages"
    for name in (*(f"{name}_{column}" for name in REPLACED for column in LISTENED), "cic"):
        try:
            read = TypeAdapter(_Mean).validate_python(listening.get(name))
        except ValidationError:
            return f"{name}: is no mean with an interval"
        if (read.mean is None) != (read.ci95 is None):
            return f"{name}: a mean needs an interval"
    return None
