"""The part of a report on interventions: what changed messages change, how far robots listen."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from marl_clean.commands.gathering import World, rows_of
from marl_clean.config.stored import EVALUATED
from marl_clean.errors import BadInput
from marl_clean.evaluation.intervened import (
    CAPTION,
    Intervened,
    listening_cells,
    read_intervened,
)
from marl_clean.evaluation.paired import Row, cell_of, compared, differences
from marl_clean.evaluation.records import MEASURED, Entry
from marl_clean.report.html import Part
from marl_clean.report.plots import Rows, changes

NOTE = (
    "The same weights, houses, starts and random actions, with changed messages: what an"
    " intervention adds to a measure."
)
STARS = "** p < 0.05 after Holm's correction, * before it"
log = logging.getLogger(__name__)

Runs = Mapping[int, Intervened]  # by seed


def interventions_of(
    worlds: Iterable[World], folders: Mapping[str, Path], names: Sequence[Mapping[str, str]]
) -> list[Part]:
    """The part, where any run was measured with changed messages; else none.

    `evaluate checkpoint=RUN intervention=all` leaves the measurements beside the runs.
    """
    read: dict[Path, Intervened | None] = {}  # once, in however many worlds a run was measured
    measured: dict[str, dict[int, Intervened]] = {}
    for world, short in zip(worlds, names, strict=True):
        for row in rows_of(world):
            for seed, entry in row.runs.items():
                folder = folders.get(entry["policy"])
                if folder is None:
                    continue
                if folder not in read:
                    read[folder] = read_beside(folder)
                if (intervened := read[folder]) is not None:
                    measured.setdefault(short[row.label], {})[seed] = intervened
    if not measured:
        return []
    tables: list[tuple[str, Rows]] = []
    shown = {}
    for label, runs in measured.items():
        reference = Row("untouched", {seed: run.untouched for seed, run in runs.items()})
        shown[label] = differences(rows_by_intervention(runs), reference)
        measures = compared(reference)
        lines = [
            [
                result["row"],
                str(len(result["seeds"])),
                *(cell_of(result[measure], measure) for measure in measures),
            ]
            for result in shown[label]
        ]
        caption = f"{label}, minus untouched; {STARS}"
        tables.append((caption, [["messages", "seeds", *measures], *lines]))
    first = next(iter(next(iter(measured.values())).values()))
    listening = first.untouched["listening"]
    tables.append((CAPTION.format(**listening), listening_of(measured)))
    timed = "T_100" in first.untouched["summary"]
    return [Part("Interventions", NOTE, tables, [changes(shown)] if timed else [])]


def rows_by_intervention(runs: Runs) -> list[Row]:
    """A row for each intervention that any of the runs was measured under, its seeds together."""
    rows: dict[str, dict[int, Entry]] = {}
    for seed, run in runs.items():
        for name, entry in run.changed.items():
            rows.setdefault(name, {})[seed] = entry
    return [Row(name, entries) for name, entries in rows.items()]


def listening_of(measured: Mapping[str, Runs]) -> Rows:
    """How far robots listen, two lines a run."""
    lines = []
    for label, runs in measured.items():
        for seed, run in runs.items():
            (titles, *rows) = listening_cells(run.untouched["listening"])
            lines += [[label, str(seed), *cells] for cells in rows]
    return [["policy", "seed", *titles], *lines]


def read_beside(folder: Path) -> Intervened | None:
    """What a run's interventions measured; nothing, with a line in the log, where it is damaged."""
    for path in (folder / MEASURED, folder.parent / EVALUATED / folder.name / MEASURED):
        try:
            intervened = read_intervened(path)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        if intervened is not None:
            return intervened
    return None
