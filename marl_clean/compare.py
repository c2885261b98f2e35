"""`marl-clean compare RUNS...`: runs that differ in their seed alone as one row, in one table."""

import json
import logging
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from marl_clean.errors import BadInput
from marl_clean.evaluation.records import Entry, read_entries, summarise, write_entries
from marl_clean.evaluation.table import make_table, output
from marl_clean.stored import RUNS, find_run, load_config

BESIDE_THE_POINT = ("seed", "name", "device", "logger", "checkpoint", "out")
log = logging.getLogger(__name__)


def main(
    runs: Sequence[str], out: Path | None = None, console: Console | None = None
) -> list[Entry]:
    """Print a table for every set of houses and return its entries, those of all seeds pooled.

    Intervals over several seeds resample runs and then houses. A folder without a finished run is
    named in one line and left out. `out`: where the entries are written as json.
    Raises BadInput when no run is left.
    """
    learned: dict[tuple[str, str], list[Entry]] = {}
    planners: dict[tuple[str, str], list[Entry]] = {}
    for run in runs:
        try:
            folder = find_run(run)
            name, setting = _name_and_setting(folder)
            entries = read_entries(folder / "evaluation.json")
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        for entry in entries:
            if entry["policy"] == name:
                learned.setdefault((setting, entry["house_set"]), []).append(entry)
            else:
                planners[entry["policy"], entry["house_set"]] = [entry]
    if not learned:
        raise BadInput(f"compare: no finished run among {', '.join(runs)}; give folders of {RUNS}/")
    rows = [pooled(entries) for entries in [*learned.values(), *planners.values()]]
    console = console or output()
    for house_set in dict.fromkeys(row["house_set"] for row in rows):
        console.print(make_table([row for row in rows if row["house_set"] == house_set]))
    if out is not None:
        write_entries(out, rows)
    return rows


def pooled(entries: Sequence[Entry]) -> Entry:
    """One policy's entries, a run each, as one; the name tells how many seeds it has.

    Raises BadInput where the runs were not measured on the same houses.
    """
    first = entries[0]
    if len(entries) == 1:
        return first
    houses = [entry["houses"] for entry in entries]
    if any([_origin(house) for house in run] != [_origin(h) for h in houses[0]] for run in houses):
        raise BadInput(f"compare: {first['policy']} and its other seeds played other houses")
    return {
        **first,
        "policy": f"{_common_start([entry['policy'] for entry in entries])} ({len(entries)} seeds)",
        "houses": [house for run in houses for house in run],
        "summary": summarise(houses),
    }


def _name_and_setting(folder: Path) -> tuple[str, str]:
    """A run's name, and all of its config that is not beside the point, as text."""
    config = load_config(folder)
    setting = {key: value for key, value in config.items() if key not in BESIDE_THE_POINT}
    return config["name"], json.dumps(setting, sort_keys=True)


def _origin(house: dict) -> int | str:
    return house["seed"] if "seed" in house else house["path"]


def _common_start(names: Sequence[str]) -> str:
    """What names begin with alike, without the marks before what differs."""
    shortest, longest = min(names), max(names)
    length = next((i for i, c in enumerate(shortest) if c != longest[i : i + 1]), len(shortest))
    return shortest[:length].removesuffix("s").rstrip("-_") or shortest
