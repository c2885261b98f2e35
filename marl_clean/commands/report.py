"""`marl-clean report RUNS...`: finished runs on one page, to read and to play; needs no torch."""

import logging
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console

from marl_clean.commands.command_line import command_line
from marl_clean.commands.compare import WorldComparison, comparison_of
from marl_clean.commands.gathering import IGNORED_KEYS, World, gather, rows_of
from marl_clean.commands.intervention_part import STARS, interventions_of
from marl_clean.commands.labels import settings_apart
from marl_clean.config.stored import METRICS, RUNS
from marl_clean.errors import BadInput
from marl_clean.evaluation.paired import cell_of
from marl_clean.evaluation.paired import compared as compared_measures
from marl_clean.evaluation.records import SHOWN, SHOWN_EXTERNAL, Entry
from marl_clean.evaluation.row_statistics import caption_of, statistics_cells
from marl_clean.evaluation.table import YARDSTICK, interval, output, row_of
from marl_clean.report.html import Part, render
from marl_clean.report.metrics import Series, read_metrics
from marl_clean.report.origin import Origin
from marl_clean.report.plots import SHOWN_TIMES, Rows, Shown, curves, plots
from marl_clean.report.recorded import REPLAY, Recording, read_recording
from marl_clean.storage import files

NOTE = (
    "Means over houses and seeds with 95 % intervals; a house not finished counts as its max_steps."
)
SETTINGS = "Only what sets the runs apart; seeds are pooled."
ON_PAGE = tuple(dict.fromkeys((*SHOWN, *SHOWN_TIMES, *SHOWN_EXTERNAL, "bits")))  # of seeds pooled
MOST_NAMES = 3  # in a title
LONGEST_NAME = 28  # characters of a row's label that a legend has room for
log = logging.getLogger(__name__)


def main(
    runs: Sequence[str],
    out: Path | None = None,
    console: Console | None = None,
    against: str | None = None,
    oracle: str | None = None,
) -> Path:
    """Write the page of `runs` to `out`, by default runs/report.html, and return its path.

    Runs that are empty, unfinished, damaged or of another version are logged in a line each and
    left out.

    `oracle`: a row's label, or runs by folder or glob, to which optimality gaps are measured too.

    Raises BadInput where no run is left, no row is labelled `against`, or nothing is `oracle`.
    """
    console = console or output()
    worlds = gather(runs)
    if not worlds:
        raise BadInput(f"report: no finished run among {', '.join(runs)}; give folders of {RUNS}/")
    comparisons = [
        comparison_of(key, world, against, ON_PAGE, oracle) for key, world in worlds.items()
    ]
    shown = dict.fromkeys(entry["policy"] for world in worlds.values() for entry in learned(world))
    title = f"{len(shown)} runs" if len(shown) != 1 else next(iter(shown))
    parts, replays = content_of(list(worlds.values()), comparisons)
    page = render(title, [NOTE], parts, replays, origin_of(comparisons))
    return write(out or RUNS / "report.html", page, console)


def origin_of(comparisons: Iterable[WorldComparison]) -> Origin:
    """The command that makes a page, and the configs of all that it shows."""
    shown = [item.entry["config_hash"] for world in comparisons for item in world.measured]
    return Origin(command_line(), shown)


def content_of(
    worlds: Sequence[World], comparisons: Sequence[WorldComparison]
) -> tuple[list[Part], list[Recording]]:
    """The parts of a page (settings that differ, each world's measures, learning), and replays."""
    folders = folders_of(worlds)
    names, settings = names_of(worlds)
    parts = [] if settings is None else [Part("Settings", SETTINGS, [("Settings", settings)])]
    titles = titles_of(worlds, names)
    parts += [part_of(*world) for world in zip(titles, worlds, comparisons, names, strict=True)]
    parts += interventions_of(worlds, folders, names)
    parts += learning_of(worlds, folders, names)
    row_of_run = rows_by_run(worlds, names)
    replays = [
        {**recording, "policy": called(row_of_run[run], recording["policy"])}
        for run, folder in folders.items()
        for recording in recordings_in(folder)
    ]
    return parts, replays


def write(path: Path, page: str, console: Console) -> Path:
    """Write a page and say where. Raises BadInput where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_file(path, [page.encode()])
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from error
    console.print(f"written to {path}", soft_wrap=True)
    return path


def learned(world: World) -> list[Entry]:
    """The entries of all runs, without planners."""
    return [entry for setting in world.settings.values() for entry in setting.runs.values()]


def folders_of(worlds: Iterable[World]) -> dict[str, Path]:
    """The folders of the runs by name; exports have none."""
    return {
        setting.runs[seed]["policy"]: folder
        for world in worlds
        for setting in world.settings.values()
        for seed, folder in setting.folders.items()
    }


def titles_of(worlds: Iterable[World], names: Sequence[Mapping[str, str]]) -> list[str]:
    """A title for each world: its houses and robots, and its rows where several have the same."""
    titles = []
    for world, short in zip(worlds, names, strict=True):
        first = next(iter(next(iter(world.settings.values())).runs.values()))
        own = list(short.values())
        shown = ", ".join(own) if len(own) <= MOST_NAMES else f"{own[0]} to {own[-1]}"
        titles.append((f"{first['house_set']}, {first['n_agents']} robots", shown))
    seen = Counter(title for title, _ in titles)
    return [f"{title}: {shown}" if seen[title] > 1 else title for title, shown in titles]


def part_of(
    title: str, world: World, comparison: WorldComparison, short: Mapping[str, str]
) -> Part:
    """One world's measures and plots; `short` are the names of its rows on the page."""
    first = comparison.entries[0]
    if "T_100" not in first["summary"]:
        return Part(title, tables=[("Returns", returns_table(comparison.entries, short))])
    rows = rows_of(world)
    statistics = {row["row"]: row for row in comparison.statistics}
    shown = [
        Shown(
            short[row.label],
            comparison.pools[row.label],
            list(row.runs.values()),
            statistics[row.label],
        )
        for row in rows
    ]
    if comparison.planner is not None:
        shown.append(Shown(YARDSTICK, comparison.planner, (), statistics[YARDSTICK]))
    tables = [("Measures", measures_table(comparison, short))]
    if comparison.reference is not None and comparison.differences:
        reference = short.get(comparison.reference.label, comparison.reference.label)
        caption = f"Minus {reference}, house by house and seed by seed; {STARS}"
        tables.append((caption, paired_table(comparison, short)))
    tables.append(statistics_table(comparison, short))
    houses = len(next(iter(rows[0].runs.values()))["houses"])
    seeds = ", ".join(f"{short[row.label]}: {len(row.runs)}" for row in rows)
    return Part(title, f"{houses} episodes a run; runs by seed: {seeds}.", tables, plots(shown))


def learning_of(
    worlds: Iterable[World], folders: Mapping[str, Path], names: Sequence[Mapping[str, str]]
) -> list[Part]:
    """The part on learning: what each run logged, a row for each setting, once for all worlds."""
    learnt: dict[str, dict[str, Mapping[str, Series]]] = {}
    for world, short in zip(worlds, names, strict=True):
        for row in rows_of(world):
            runs = learnt.setdefault(short[row.label], {})
            for entry in row.runs.values():
                name = entry["policy"]
                if name in folders and name not in runs:
                    runs[name] = metrics_of(folders[name])
    drawn = curves(learnt)
    return (
        [Part("Learning", "On validation houses; a thin line a seed.", (), drawn)] if drawn else []
    )


def names_of(worlds: Iterable[World]) -> tuple[list[dict[str, str]], Rows | None]:
    """Each world's names of rows by their labels, and a table of the settings that differ.

    A setting has one name on the page, in whatever worlds it was measured: its label where all are
    short and no two settings share it; else settings are A, B, C, ...
    """
    worlds = list(worlds)
    rows = [list(zip(rows_of(world), world.settings.items(), strict=True)) for world in worlds]
    settings = {key: setting for world in rows for _, (key, setting) in world}
    label_of = {key: row.label for world in reversed(rows) for row, (key, _) in reversed(world)}
    labels = [label_of[key] for key in settings]
    letters = max(map(len, labels)) > LONGEST_NAME or len(set(labels)) < len(labels)
    names = {key: letter(i) if letters else label_of[key] for i, key in enumerate(settings)}
    short = [{row.label: names[key] for row, (key, _) in world} for world in rows]
    stored = [setting.config for setting in settings.values() if setting.config is not None]
    if len(stored) < 2 or len(stored) < len(settings):  # exports hold no configs
        return short, None
    apart = settings_apart(stored, IGNORED_KEYS)
    keys = list(dict.fromkeys(key for differing in apart for key in differing))
    lines = [
        [name, *(differing.get(key, "") for key in keys)]
        for name, differing in zip(names.values(), apart, strict=True)
    ]
    return short, [["policy", *keys], *lines]


def letter(index: int) -> str:
    """A, B, ..., Z, A1, B1, ..."""
    return f"{chr(ord('A') + index % 26)}{index // 26 or ''}"


def metrics_of(folder: Path) -> Mapping[str, Series]:
    """What a run logged; nothing, with a line in the log, where its metrics.csv is damaged."""
    if not (folder / METRICS).is_file():
        return {}
    try:
        return read_metrics(folder / METRICS)
    except BadInput as error:
        log.warning("left out: %s", error)
        return {}


def rows_by_run(worlds: Iterable[World], names: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The name on the page of each run's row, by the run's name."""
    return {
        entry["policy"]: short[row.label]
        for world, short in zip(worlds, names, strict=True)
        for row in rows_of(world)
        for entry in row.runs.values()
    }


def called(row: str, policy: str) -> str:
    """A recorded run in the list of replays: with its row's name, where that is another."""
    return policy if row == policy else f"{row}: {policy}"


def recordings_in(folder: Path) -> list[Recording]:
    """The run's recorded episode, if it has one that is whole."""
    if not (folder / REPLAY).is_file():
        return []
    try:
        return [read_recording(folder / REPLAY)]
    except BadInput as error:
        log.warning("left out: %s", error)
        return []


def measures_table(comparison: WorldComparison, short: Mapping[str, str]) -> Rows:
    """The cells of the table in the terminal."""
    titles = ["policy", "finished", "T_90", "x", "T_100", "x", "coverage", "redundancy"]
    lines = [
        [name_of(entry, short), *row_of(entry, comparison.planner)] for entry in comparison.entries
    ]
    return [titles, *lines]


def name_of(entry: Entry, short: Mapping[str, str]) -> str:
    """The name on the page of a row's pooled entry, or of a planner's."""
    label, seeds, number = entry["policy"].partition(" (")
    return f"{short.get(label, label)}{seeds}{number}"


def statistics_table(comparison: WorldComparison, short: Mapping[str, str]) -> tuple[str, Rows]:
    """Interquartile means, gaps and probabilities; the means stand in the first table."""
    named = [{**row, "row": short.get(row["row"], row["row"])} for row in comparison.statistics]
    for row in named:
        if "improvement" in row:
            over = row["improvement"]["over"]
            row["improvement"] = {**row["improvement"], "over": short.get(over, over)}
    cells = statistics_cells(named)
    kept = [place for place, title in enumerate(cells[0]) if title not in SHOWN]
    return caption_of(named) or "", [[line[place] for place in kept] for line in cells]


def returns_table(entries: Sequence[Entry], short: Mapping[str, str]) -> Rows:
    lines = [[name_of(entry, short), interval(entry["summary"]["return"])] for entry in entries]
    return [["policy", "return"], *lines]


def paired_table(comparison: WorldComparison, short: Mapping[str, str]) -> Rows:
    """Paired differences; ** and * as in the terminal: p < 0.05 after and before correction."""
    assert comparison.reference is not None
    measures = compared_measures(comparison.reference)
    lines = [
        [
            short[result["row"]],
            str(len(result["seeds"])),
            *(cell_of(result[measure], measure) for measure in measures),
        ]
        for result in comparison.differences
    ]
    return [["policy", "seeds", *measures], *lines]
