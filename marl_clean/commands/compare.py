"""`marl-clean compare RUNS...`: seeds pooled, settings compared in pairs on the same houses."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from marl_clean.commands.labels import labels, level_of
from marl_clean.config.config_hash import OUTSIDE_THE_HASH
from marl_clean.config.schema import choices
from marl_clean.config.stored import RUNS, find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.paired import Row, differences, make_paired_table, unpaired_seeds
from marl_clean.evaluation.records import MEASURED, Entry, read_entries, summarise, write_entries
from marl_clean.evaluation.table import YARDSTICK, make_table, output
from marl_clean.storage import files
from marl_clean.storage.manifest import count_weights

IGNORED_KEYS = (*OUTSIDE_THE_HASH, "seed")  # runs of one setting may differ in these
SPEED_KEYS = ("num_envs", "compile")  # of the env: they change its speed, not its rules
log = logging.getLogger(__name__)

Config = Mapping[str, Any]


@dataclass
class Setting:
    """Runs of one config in one world, by their seed."""

    config: Config
    runs: dict[int, Entry] = field(default_factory=dict)
    parameters: int | None = None


@dataclass
class World:
    """What was measured in one world on the same houses: settings of learners, and planners."""

    settings: dict[str, Setting] = field(default_factory=dict)
    planners: dict[str, Entry] = field(default_factory=dict)


@dataclass(frozen=True)
class WorldComparison:
    """One world's comparison.

    Attributes:
        pools: each setting's entries, its seeds pooled, by its label.
        planner: the yardstick's entry.
        entries: of all policies, the planners last.
        reference: the row that others are compared with; None where there is only one row.
        differences: of each row to it, measure by measure.
    """

    pools: dict[str, Entry]
    planner: Entry | None
    entries: list[Entry]
    reference: Row | None
    differences: list[dict[str, Any]]


def main(
    runs: Sequence[str],
    out: Path | None = None,
    console: Console | None = None,
    against: str | None = None,
    figure: bool = True,
) -> list[Entry]:
    """Print two tables for every set of houses and return their entries, those of all seeds pooled.

    The first has means, the second each setting's paired difference to one of them: `against`,
    or the first without communication (`comm=none`), or the first. Intervals over several seeds
    resample runs and then houses. A folder without a finished run is logged in one line and left
    out. `out`: where the entries are written as json; the differences are written beside it, as
    `<out>_paired.json`. `figure`: draw runs/figures/compare*.png and .svg.
    Raises BadInput when no run is left, or no row is labelled `against`.
    """
    console = console or output()
    worlds = compared(runs, against)
    for number, world in enumerate(worlds, start=1):
        console.print(make_table(world.entries))
        if world.reference is not None and world.differences:
            console.print(make_paired_table(world.differences, world.reference))
        if figure and world.pools and "T_100" in world.entries[0]["summary"]:
            draw(world.pools, world.planner, world.differences, number, console)
    written = [entry for world in worlds for entry in world.entries]
    if out is not None:
        write_entries(out, written)
        paired = [difference for world in worlds for difference in world.differences]
        beside = out.with_name(f"{out.stem}_paired.json")
        files.write_file(beside, [(json.dumps(paired, indent=1) + "\n").encode()])
    return written


def compared(runs: Sequence[str], against: str | None = None) -> list[WorldComparison]:
    """Pool the seeds of finished runs, and compare each setting with a reference, world by world.

    Raises BadInput when no run is left, or no row is labelled `against`.
    """
    worlds = gather(runs)
    if not worlds:
        raise BadInput(f"compare: no finished run among {', '.join(runs)}; give folders of {RUNS}/")
    return [_compared(world, against) for world in worlds]


def _compared(world: World, against: str | None) -> WorldComparison:
    rows = rows_of(world)
    pools = {row.label: pooled(list(row.runs.values()), row.label) for row in rows}
    entries = [*pools.values(), *world.planners.values()]
    entries.sort(key=lambda entry: entry["epsilon"] == 0)  # the planners last
    planner = world.planners.get(YARDSTICK)
    if len(rows) < 2 and against is None:
        return WorldComparison(pools, planner, entries, None, [])
    reference = reference_of(world, rows, against)
    if unpaired := unpaired_seeds(rows, reference):
        listed = "; ".join(unpaired)
        log.warning("seeds that %s cannot be paired with: %s", reference.label, listed)
    return WorldComparison(pools, planner, entries, reference, differences(rows, reference))


def gather(runs: Sequence[str]) -> list[World]:
    """What the finished runs among `runs` measured, world by world; other folders are logged."""
    worlds: dict[str, World] = {}
    seen: set[Path] = set()
    for run in runs:
        try:
            folder = find_run(run)
            config = load_config(folder)
            entries = read_entries(folder / MEASURED)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        if config["name"] not in {entry["policy"] for entry in entries}:
            log.warning("left out: %s: has no entry of its own run", folder / MEASURED)
            continue
        if folder.resolve() in seen:
            continue
        seen.add(folder.resolve())
        for entry in entries:
            world = worlds.setdefault(world_key(entry, config["env"]), World())
            if entry["policy"] != config["name"]:  # a planner acts alike in one world
                world.planners[entry["policy"]] = entry
                continue
            setting = world.settings.setdefault(_setting_key(config), Setting(config))
            setting.runs[config["seed"]] = entry
            setting.parameters = count_weights(folder)
    return list(worlds.values())


def rows_of(world: World) -> list[Row]:
    """One row per setting, labelled by what sets it apart from the others."""
    settings = list(world.settings.values())
    if len(settings) == 1:
        names = [_common_prefix([entry["policy"] for entry in settings[0].runs.values()])]
    else:
        names = labels([setting.config for setting in settings], IGNORED_KEYS)
    return [
        Row(name, dict(setting.runs), setting.parameters)
        for name, setting in zip(names, settings, strict=True)
    ]


def reference_of(world: World, rows: Sequence[Row], against: str | None) -> Row:
    """The row that the others are compared with: `against`, else one without communication.

    Without either it is the first.

    Raises BadInput where no row is labelled `against`.
    """
    planners = [Row(name, {None: entry}) for name, entry in world.planners.items()]
    if against is not None:
        by_label = {row.label: row for row in (*rows, *planners)}
        if against not in by_label:
            raise BadInput(f"--against {against}: no such row; {choices(against, by_label)}")
        return by_label[against]
    silent = [
        row
        for row, setting in zip(rows, world.settings.values(), strict=True)
        if level_of(setting.config["comm"]) == "none"
    ]
    return silent[0] if silent else rows[0]


def draw(
    pools: Mapping[str, Entry],
    planner: Entry | None,
    differences: Sequence[Mapping[str, Any]],
    number: int,
    console: Console,
) -> None:
    """Draw one world's figure."""
    from marl_clean.report.axes import save_figure
    from marl_clean.report.comparison import draw_comparison

    first = next(iter(pools.values()))
    title = f"{first['house_set']}, {first['n_agents']} robots; 95 % intervals"
    rows = {name: (entry, planner) for name, entry in pools.items()}
    figure = draw_comparison(title, rows, differences)
    name = "compare" if number == 1 else f"compare_{number}"
    for path in save_figure(figure, RUNS / "figures" / name):
        console.print(f"written to {path}", soft_wrap=True)


def pooled(entries: Sequence[Entry], label: str | None = None) -> Entry:
    """One policy's entries, a run each on the same houses, as one; its name has their number."""
    first = entries[0]
    name = label or _common_prefix([entry["policy"] for entry in entries])
    if len(entries) == 1:
        return {**first, "policy": label or first["policy"]}
    houses = [entry["houses"] for entry in entries]
    return {
        **first,
        "policy": f"{name} ({len(entries)} seeds)",
        "houses": [house for run in houses for house in run],
        "summary": summarise(houses),
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


def world_key(entry: Entry, env: Mapping[str, Any]) -> str:
    """A text that comparable entries share: the world's rules, and the same houses and starts."""
    ignored = (*SPEED_KEYS, "n_agents")  # an entry may be of another team size than training
    rules = {key: value for key, value in env.items() if key not in ignored}
    names = ("seed", "path", "rows", "cols", "free_cells", "bound_100", "max_steps")
    houses = [[house.get(name) for name in names] for house in entry["houses"]]
    return json.dumps([rules, entry["house_set"], entry["n_agents"], houses], sort_keys=True)


def _setting_key(config: Config) -> str:
    """A text that runs share which differ in their seeds alone: the rest of their config."""
    setting = {key: value for key, value in config.items() if key not in IGNORED_KEYS}
    return json.dumps(setting, sort_keys=True)


def _common_prefix(names: Sequence[str]) -> str:
    """The common prefix of names, without the separators at its end."""
    shortest, longest = min(names), max(names)
    length = next((i for i, c in enumerate(shortest) if c != longest[i : i + 1]), len(shortest))
    return shortest[:length].removesuffix("s").rstrip("-_") or shortest
