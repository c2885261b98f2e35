"""`marl-clean compare RUNS...`: seeds pooled, settings compared in pairs on the same houses."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from marl_clean.commands.command_line import command_line
from marl_clean.commands.efficiency_part import EFFICIENCY, efficiency_of, to_csv, validated
from marl_clean.commands.gathering import (
    World,
    common_prefix,
    engineered_of,
    gather,
    measured_of,
    planners_of,
    reference_of,
    rows_of,
)
from marl_clean.commands.twins import ORACLE, add_gains, twin_of
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput
from marl_clean.evaluation import marl_eval, tidy
from marl_clean.evaluation.flat import to_flat
from marl_clean.evaluation.gains import make_gains_table
from marl_clean.evaluation.latex import to_latex
from marl_clean.evaluation.measured import Measured
from marl_clean.evaluation.paired import Row, differences, make_paired_table, unpaired_seeds
from marl_clean.evaluation.records import MEASURES, Entry, summarise, write_entries
from marl_clean.evaluation.row_statistics import make_statistics_table, row_statistics
from marl_clean.evaluation.table import YARDSTICK, make_table, output
from marl_clean.storage import files

LATEX, FLAT = "tables.tex", "statistics.csv"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorldComparison:
    """One world's comparison.

    Attributes:
        pools: each setting's entries, its seeds pooled, by its label.
        planner: the yardstick's entry.
        entries: of all policies, the planners last.
        reference: the row that others are compared with; None where there is only one row.
        differences: of each row to it, measure by measure.
        statistics: of each row and planner, as `evaluation.row_statistics` describes.
        measured: every run and planner, as an export writes it.
        engineered: labels of rows whose messages are not learnt; of an export it is not known.
    """

    pools: dict[str, Entry]
    planner: Entry | None
    entries: list[Entry]
    reference: Row | None
    differences: list[dict[str, Any]]
    statistics: list[dict[str, Any]]
    measured: list[Measured]
    engineered: list[str]


def main(
    runs: Sequence[str],
    out: Path | None = None,
    console: Console | None = None,
    against: str | None = None,
    figure: bool = True,
    export: Path | None = None,
    silent: str | None = None,
    oracle: str | None = None,
) -> list[Entry]:
    """Print tables for every set of houses and return their entries, those of all seeds pooled.

    The first has means, the second interquartile means, the third each setting's paired difference
    to one of them: `against`, or the first without communication (`comm=none`), or the first.
    A folder without a finished run is logged in one line and left out. `out`: where the entries are
    written as json; the rest is written beside it, as `<out>_paired.json` and
    `<out>_statistics.json`. `figure`: draw runs/figures/compare*.png and .svg. `export`: a folder
    for tables.tex, statistics.csv, efficiency.csv, marl_eval.json and tidy.csv; `runs` may name the
    last two in place of folders. `silent`, `oracle`: labels of rows, or runs by folder or glob,
    between which recovered headroom and protocols are measured, and gaps to the oracle.
    Raises BadInput when no run is left, or no row is what `against`, `silent` or `oracle` names.
    """
    console = console or output()
    worlds = compared(runs, against, silent, oracle)
    for number, world in enumerate(worlds, start=1):
        console.print(make_table(world.entries))
        console.print(make_statistics_table(world.statistics))
        if (gains := make_gains_table(world.statistics)) is not None:
            console.print(gains)
        if world.reference is not None and world.differences:
            console.print(make_paired_table(world.differences, world.reference))
        if figure and world.pools and "T_100" in world.entries[0]["summary"]:
            draw(world, number, console)
    written = [entry for world in worlds for entry in world.entries]
    if out is not None:
        write_entries(out, written)
        beside = {
            "paired": [difference for world in worlds for difference in world.differences],
            "statistics": [row for world in worlds for row in world.statistics],
        }
        for kind, rows in beside.items():
            text = json.dumps(rows, indent=1) + "\n"
            path = out.with_name(f"{out.stem}_{kind}.json")
            with files.writing(path):
                files.write_file(path, [text.encode()])
    if export is not None:
        for path in write_exports(export, worlds):
            console.print(f"written to {path}", soft_wrap=True)
    return written


def write_exports(folder: Path, worlds: Sequence[WorldComparison]) -> list[Path]:
    """Write the exports. Raises BadInput where they cannot be written."""
    measured = [item for world in worlds for item in world.measured]
    curves = validated(measured)
    texts = {
        marl_eval.NAME: marl_eval.to_marl_eval(measured, curves),
        tidy.NAME: tidy.to_tidy(measured),
        LATEX: to_latex([world.statistics for world in worlds]),
        FLAT: to_flat([row for world in worlds for row in world.statistics]),
        EFFICIENCY: to_csv(efficiency_of(measured, curves)),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            files.write_file(folder / name, [text.encode()])
    except OSError as error:
        raise BadInput(f"--export {folder}: cannot be written: {error.strerror}") from error
    return [folder / name for name in texts]


def compared(
    runs: Sequence[str],
    against: str | None = None,
    silent: str | None = None,
    oracle: str | None = None,
) -> list[WorldComparison]:
    """Pool the seeds of finished runs, and compare each setting with a reference, world by world.

    With `silent` or `oracle`, also with these. Raises BadInput when no run is left, or no row is
    what these three name.
    """
    worlds = gather(runs)
    if not worlds:
        given = ", ".join(runs)
        raise BadInput(
            f"compare: no finished run among {given}; give folders of {RUNS}/, or exports"
        )
    comparisons = [
        comparison_of(key, world, against, oracle=oracle) for key, world in worlds.items()
    ]
    if silent is not None or oracle is not None:
        add_gains(list(worlds.values()), [item.statistics for item in comparisons], silent, oracle)
    return comparisons


def comparison_of(
    key: str,
    world: World,
    against: str | None = None,
    measures: Sequence[str] = MEASURES,
    oracle: str | None = None,
) -> WorldComparison:
    """One world's rows, compared with a reference; `measures`: those of pooled entries.

    `oracle`: a row, or runs, to which optimality gaps are measured where the houses are the same.
    Raises BadInput where no row is `against`, or nothing is `oracle`.
    """
    rows = rows_of(world)
    pools = {row.label: pooled(list(row.runs.values()), row.label, measures) for row in rows}
    entries = [*pools.values(), *world.planners.values()]
    entries.sort(key=lambda entry: entry["epsilon"] == 0)  # the planners last
    planner = world.planners.get(YARDSTICK)
    every = [*rows, *planners_of(world)]
    best = None if oracle is None else twin_of(ORACLE, oracle, world, rows)
    measured, engineered = measured_of(key, world, rows), engineered_of(world, rows)
    if len(rows) < 2 and against is None:
        statistics = row_statistics(every, None, best)
        return WorldComparison(pools, planner, entries, None, [], statistics, measured, engineered)
    reference = reference_of(world, rows, against)
    if unpaired := unpaired_seeds(rows, reference):
        listed = "; ".join(unpaired)
        log.warning("seeds that %s cannot be paired with: %s", reference.label, listed)
    statistics = row_statistics(every, reference, best)
    compared = differences(rows, reference)
    return WorldComparison(
        pools, planner, entries, reference, compared, statistics, measured, engineered
    )


def draw(world: WorldComparison, number: int, console: Console) -> None:
    """Draw one world's figures: means and differences, profiles, probabilities of improvement."""
    from marl_clean.report.axes import save_figure
    from marl_clean.report.comparison import draw_comparison
    from marl_clean.report.origin import Origin
    from marl_clean.report.profiles import draw_efficiency, draw_improvement, draw_profiles
    from marl_clean.report.recovered import draw_recovered

    first = next(iter(world.pools.values()))
    title = f"{first['house_set']}, {first['n_agents']} robots; 95 % intervals"
    rows = {name: (entry, world.planner) for name, entry in world.pools.items()}
    figures = {
        "compare": draw_comparison(title, rows, world.differences),
        "compare_profiles": draw_profiles(title, world.statistics),
    }
    if world.reference is not None:
        figures["compare_improvement"] = draw_improvement(title, world.statistics)
    if curves := efficiency_of(world.measured, validated(world.measured)):
        figures["compare_efficiency"] = draw_efficiency(title, curves)
    if any("recovered" in row for row in world.statistics):
        by_name = {**world.pools, **{entry["policy"]: entry for entry in world.entries}}
        bits = {name: entry["summary"]["bits"]["mean"] for name, entry in by_name.items()}
        shown = (title, world.statistics, bits, world.engineered)
        figures["compare_recovered"] = draw_recovered(*shown)
    hashes = [item.entry["config_hash"] for item in world.measured]
    origin = Origin(command_line(), hashes)
    for name, figure in figures.items():
        stem = name if number == 1 else f"{name}_{number}"
        for path in save_figure(figure, RUNS / "figures" / stem, origin):
            console.print(f"written to {path}", soft_wrap=True)


def pooled(
    entries: Sequence[Entry], label: str | None = None, measures: Sequence[str] = MEASURES
) -> Entry:
    """One policy's entries, a run each on the same houses, as one; its name has their number."""
    first = entries[0]
    name = label or common_prefix([entry["policy"] for entry in entries])
    if len(entries) == 1:
        return {**first, "policy": label or first["policy"]}
    houses = [entry["houses"] for entry in entries]
    return {
        **first,
        "policy": f"{name} ({len(entries)} seeds)",
        "runs": len(entries),
        "houses": [house for run in houses for house in run],
        "summary": summarise(houses, measures),
    }


def tables_of(
    runs: Mapping[str, Sequence[Sequence[Entry]]],
) -> list[dict[str, tuple[Entry, Entry]]]:
    """Return each row's entry, its seeds pooled, and the planner's, a table for a set of houses.

    `runs`: of each row the entries of each seed's run, its own first. Rows trained in other houses
    have test houses of their own; only sets that all rows share make a table.
    """
    tables: dict[str, dict[str, tuple[Entry, Entry]]] = {}
    for label, seeds in runs.items():
        sets: dict[str, list[Entry]] = {}
        for entry in (entry for entries in seeds for entry in entries):
            sets.setdefault(houses_of(entry), []).append(entry)
        names = {entries[0]["policy"] for entries in seeds}
        for houses, entries in sets.items():
            learned = [entry for entry in entries if entry["policy"] in names]
            planner = next(entry for entry in entries if entry["policy"] == YARDSTICK)
            tables.setdefault(houses, {})[label] = pooled(learned, label), planner
    return [rows for rows in tables.values() if len(rows) == len(runs)]


def houses_of(entry: Entry) -> str:
    """Return a text that entries on the same houses with as many robots share."""
    houses = [
        [house.get(key) for key in ("seed", "path", "rows", "cols")] for house in entry["houses"]
    ]
    return json.dumps([entry["house_set"], entry["n_agents"], houses])
