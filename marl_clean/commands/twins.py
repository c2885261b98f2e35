"""What `compare` compares arms with by `--silent` and `--oracle`: a row, or runs of another world.

An oracle hears what an arm has to be told, as by merged maps: its rules are others, so it stands
in no table with the arm. It counts as comparable by its houses and starts alone.
"""

import glob
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_clean.commands.gathering import World, common_prefix, gather, planners_of, rows_of
from marl_clean.commands.intervention_part import read_beside
from marl_clean.config.schema import choices
from marl_clean.errors import BadInput
from marl_clean.evaluation.gains import protocols_of, recovered_of
from marl_clean.evaluation.paired import Row, unpaired_seeds
from marl_clean.evaluation.records import Entry

ZERO, SILENT, ORACLE = "zero", "--silent", "--oracle"
PLACES = ("seed", "path", "rows", "cols", "free_cells", "bound_100")
log = logging.getLogger(__name__)


def twin_of(option: str, name: str, world: World, rows: Sequence[Row]) -> Row | None:
    """The row that `name` is the label of, or that the runs it names make in these houses.

    None where runs were measured in other houses or from other starts alone. Raises BadInput where
    there is neither, or they are of several settings.
    """
    labelled = {row.label: row for row in (*rows, *planners_of(world))}
    if name in labelled:
        return labelled[name]
    folders = sorted(glob.glob(name)) or ([name] if Path(name).exists() else [])
    if not folders:
        valid = choices(name, labelled)
        raise BadInput(f"{option} {name}: no such row, and no folder of a run; {valid}")
    own = places_of(_an_entry(world))
    settings = [
        setting
        for other in gather(folders).values()
        for setting in other.settings.values()
        if own == places_of(next(iter(setting.runs.values())))
    ]
    if not settings:
        return None
    if len(settings) > 1:
        raise BadInput(f"{option} {name}: its runs are of {len(settings)} settings; name one's")
    [setting] = settings
    label = common_prefix([entry["policy"] for entry in setting.runs.values()])
    return Row(setting.label or label, dict(setting.runs), setting.parameters)


def places_of(entry: Entry) -> str:
    """A text that entries on the same houses from the same starts share, whatever the rules."""
    houses = [[house.get(name) for name in PLACES] for house in entry["houses"]]
    return json.dumps([entry["house_set"], entry["n_agents"], houses])


def zeroed_of(world: World, rows: Sequence[Row]) -> dict[str, dict[int, Entry]]:
    """What runs measured with their messages zeroed, by row and seed.

    `evaluate checkpoint=RUN intervention=zero` leaves it beside the runs.
    """
    measured: dict[str, dict[int, Entry]] = {}
    for row, setting in zip(rows, world.settings.values(), strict=True):
        for seed, folder in setting.folders.items():
            intervened = read_beside(folder)
            zeroed = None if intervened is None else intervened.changed.get(ZERO)
            if zeroed is None:
                continue
            if places_of(zeroed) == places_of(row.runs[seed]):
                measured.setdefault(row.label, {})[seed] = zeroed
            else:
                log.warning("left out: %s: its messages were zeroed in other houses", folder)
    return measured


def _an_entry(world: World) -> Entry:
    """Any entry; all are on the same houses."""
    entries: list[Mapping[str, Any]] = [
        entry for setting in world.settings.values() for entry in setting.runs.values()
    ]
    return dict((entries or list(world.planners.values()))[0])


def add_gains(
    worlds: Sequence[World],
    statistics: Sequence[list[dict[str, Any]]],
    silent: str | None,
    oracle: str | None,
) -> None:
    """Add `recovered` and `protocols` to the statistics of each world's rows, in place.

    Without `silent` it is the world's row without communication. Rows measured in other houses
    than the named runs get neither. Raises BadInput where a name is of no row, or pairs with none.
    """
    paired = {SILENT: silent is None, ORACLE: oracle is None}
    for world, of_rows in zip(worlds, statistics, strict=True):
        rows = rows_of(world)
        start = _silent_of(world, rows) if silent is None else twin_of(SILENT, silent, world, rows)
        end = None if oracle is None else twin_of(ORACLE, oracle, world, rows)
        paired[SILENT] |= start is not None
        paired[ORACLE] |= end is not None
        if start is None or "T_100" not in _an_entry(world)["houses"][0]:
            continue
        for twin in (start, *([] if end is None else [end])):
            if unpaired := unpaired_seeds(rows, twin):
                log.warning("seeds without a twin in %s: %s", twin.label, "; ".join(unpaired))
        zeroed = zeroed_of(world, rows)
        by_label = {row["row"]: row for row in of_rows}
        for row in (*rows, *planners_of(world)):
            result = by_label[row.label]
            if end is not None:
                result["recovered"] = recovered_of(row, start, end)
            if row.label in zeroed and row.label != start.label:
                result["protocols"] = protocols_of(row, start, zeroed[row.label])
    for option, name in ((SILENT, silent), (ORACLE, oracle)):
        if not paired[option]:
            raise BadInput(
                f"{option} {name}: was measured in other houses or from other starts than all rows,"
                " and cannot be paired"
            )


def _silent_of(world: World, rows: Sequence[Row]) -> Row:
    """The row without communication. Raises BadInput without exactly one."""
    settings = world.settings.values()
    silent = [row for row, setting in zip(rows, settings, strict=True) if setting.silent]
    if len(silent) != 1:
        held = ", ".join(row.label for row in silent) or "none"
        raise BadInput(f"--oracle: rows without communication: {held}; name one by {SILENT} ROW")
    return silent[0]
