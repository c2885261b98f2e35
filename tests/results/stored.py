"""Tables of results as they are stored, in docs/tables: means and intervals, no single houses.

A table is a JSON object: `about` says how it was measured, `commands` make it, and `entries` are
what they measured. An entry has the name of its `row`, the `place` (a set of houses), `n_agents`,
the numbers of `seeds` and `houses`, the `config_sha256` of its runs, the shares `finished` and
`coverage`, and each time as `{"mean", "low", "high"}` in steps, the 95 % interval null where it was
not kept. `not_stored` names rows of the page that were measured before records were kept.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from marl_clean.evaluation.records import Entry, summarise

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "tables"
TIMES = ("T_90", "T_100")
DIGITS = 7  # that are kept of a number
SCHEMA = 1


@dataclass(frozen=True)
class Table:
    """A stored table, its entries by row, place and number of robots."""

    name: str
    not_stored: Sequence[str]
    entries: Mapping[tuple[str, str, int], Mapping[str, Any]]

    def entry(self, row: str, place: str, n_agents: int = 2) -> Mapping[str, Any]:
        """One entry. Raises KeyError where it is not stored."""
        return self.entries[row, place, n_agents]

    def rows(self) -> list[str]:
        """The names of the rows, in their order."""
        return list(dict.fromkeys(row for row, _, _ in self.entries))


def read(name: str) -> Table:
    """The stored table of this name."""
    content = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    assert content["schema"] == SCHEMA and content["commands"] and content["about"], name
    keys = [(entry["row"], entry["place"], entry["n_agents"]) for entry in content["entries"]]
    assert len(set(keys)) == len(keys), name
    return Table(name, content["not_stored"], dict(zip(keys, content["entries"], strict=True)))


def write(
    name: str,
    about: str,
    commands: Sequence[str],
    entries: Iterable[dict[str, Any]],
    not_stored: Sequence[str] = (),
) -> Path:
    """Write a table, an entry a line, so that a change of one is seen as one."""
    lines = ",\n  ".join(json.dumps(entry) for entry in entries)
    head = {
        "schema": SCHEMA,
        "about": about,
        "commands": list(commands),
        "not_stored": list(not_stored),
    }
    text = json.dumps(head, indent=1)[:-2] + f',\n "entries": [\n  {lines}\n ]\n}}\n'
    path = FOLDER / f"{name}.json"
    path.write_text(text, encoding="utf-8")
    return path


def entry_of(row: str, measured: Sequence[Entry]) -> dict[str, Any]:
    """An entry from those of each seed's evaluation.json, of one place."""
    first, houses = measured[0], [entry["houses"] for entry in measured]
    summary = summarise(houses)
    return {
        "row": row,
        "place": place_of(first),
        "n_agents": first["n_agents"],
        "seeds": len(measured),
        "houses": len(first["houses"]),
        "config_sha256": [entry["config_hash"] for entry in measured],
        "finished": rounded(summary["T_100"]["reached"]),
        "coverage": rounded(summary["coverage"]["mean"]),
        **{measure: estimate(summary[measure]) for measure in TIMES},
    }


def estimate(summary: Mapping[str, Any]) -> dict[str, float]:
    """A time's mean and interval."""
    low, high = summary["ci95"]
    return {
        name: rounded(v) for name, v in (("mean", summary["mean"]), ("low", low), ("high", high))
    }


def place_of(entry: Entry) -> str:
    """The set of houses as pages call it: `20x20`, or the name of a plan."""
    place = entry["house_set"].removeprefix("test").strip()
    sizes = {(house["rows"], house["cols"]) for house in entry["houses"]}
    if place or len(sizes) > 1:
        return place or "own"
    [(rows, cols)] = sizes
    return f"{rows}x{cols}"


def rounded(value: float) -> float:
    """The value with as many digits as are kept."""
    return float(f"{value:.{DIGITS}g}")
