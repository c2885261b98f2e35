"""`marl-clean compare RUNS...`: runs that differ in their seed alone as one row, in one table."""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from marl_clean.compose import OUTSIDE_THE_HASH
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import MEASURED, Entry, read_entries, summarise, write_entries
from marl_clean.evaluation.table import make_table, output
from marl_clean.stored import RUNS, find_run, load_config

BESIDE_THE_POINT = (*OUTSIDE_THE_HASH, "seed")
OF_THE_MACHINE = ("num_envs", "compile")  # of the env: how it is played, not what
log = logging.getLogger(__name__)


def main(
    runs: Sequence[str], out: Path | None = None, console: Console | None = None
) -> list[Entry]:
    """Print a table for every set of houses and return its entries, those of all seeds pooled.

    Intervals over several seeds resample runs and then houses. A folder without a finished run is
    named in one line and left out. `out`: where the entries are written as json.
    Raises BadInput when no run is left.
    """
    tables: dict[str, dict[str, list[Entry]]] = {}  # by what was played, then by row
    for run in runs:
        try:
            folder = find_run(run)
            config = load_config(folder)
            entries = read_entries(folder / MEASURED)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        for entry in entries:
            table = tables.setdefault(_what_was_played(entry, config["env"]), {})
            if entry["policy"] == config["name"]:
                table.setdefault(_apart_from_the_seed(config), []).append(entry)
            else:
                table[entry["policy"]] = [entry]  # in one world a planner plays alike for every run
    if not tables:
        raise BadInput(f"compare: no finished run among {', '.join(runs)}; give folders of {RUNS}/")
    console = console or output()
    rows = []
    for table in tables.values():
        of_table = [pooled(entries) for entries in table.values()]
        of_table.sort(key=lambda row: row["epsilon"] == 0)  # the planners last
        console.print(make_table(of_table))
        rows += of_table
    if out is not None:
        write_entries(out, rows)
    return rows


def pooled(entries: Sequence[Entry]) -> Entry:
    """One policy's entries, a run each on the same houses, as one; its name tells how many."""
    first = entries[0]
    if len(entries) == 1:
        return first
    houses = [entry["houses"] for entry in entries]
    return {
        **first,
        "policy": f"{_common_start([entry['policy'] for entry in entries])} ({len(entries)} seeds)",
        "houses": [house for run in houses for house in run],
        "summary": summarise(houses),
    }


def _apart_from_the_seed(config: Mapping[str, Any]) -> str:
    """All of a run's config that makes it another policy than its other seeds, as text."""
    setting = {key: value for key, value in config.items() if key not in BESIDE_THE_POINT}
    return json.dumps(setting, sort_keys=True)


def _what_was_played(entry: Entry, env: Mapping[str, Any]) -> str:
    """What makes entries comparable: one world's rules, and the same houses and starts."""
    rules = {key: value for key, value in env.items() if key not in OF_THE_MACHINE}
    names = ("seed", "path", "rows", "cols", "free_cells", "bound_100", "max_steps")
    houses = [[house.get(name) for name in names] for house in entry["houses"]]
    return json.dumps([rules, entry["house_set"], entry["n_agents"], houses], sort_keys=True)


def _common_start(names: Sequence[str]) -> str:
    """What names begin with alike, without the marks before what differs."""
    shortest, longest = min(names), max(names)
    length = next((i for i, c in enumerate(shortest) if c != longest[i : i + 1]), len(shortest))
    return shortest[:length].removesuffix("s").rstrip("-_") or shortest
