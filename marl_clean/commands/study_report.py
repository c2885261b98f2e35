"""`marl-clean report STUDY`: which rules are met, and every run that the study registered.

The page is of exactly the registered runs; one that failed or is missing stays in the table.
"""

from collections.abc import Mapping, Sequence
from glob import glob
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from marl_clean.commands.compare import WorldComparison, comparison_of
from marl_clean.commands.frozen import FROZEN, Frozen, read_frozen
from marl_clean.commands.gathering import World, gather, rows_of
from marl_clean.commands.report import NOTE, ON_PAGE, content_of, origin_of, write
from marl_clean.commands.run_info import State
from marl_clean.commands.study import STUDIES
from marl_clean.commands.twins import add_gains
from marl_clean.commands.verdicts import Run, Verdict, judge, runs_of
from marl_clean.config.stored import CONFIG, RUNS
from marl_clean.errors import BadInput
from marl_clean.evaluation.gains import gain_cells
from marl_clean.evaluation.paired import Row, values
from marl_clean.evaluation.records import MEASURED
from marl_clean.evaluation.rules import Effect
from marl_clean.evaluation.table import NONE, output
from marl_clean.report.html import Part, render
from marl_clean.report.plots import Rows

RULES = (
    "Registered before the first run. Met: p after Holm's correction over all rules is below "
    "{alpha:g} and the estimate lies on the rule's side; not met: on the other side; undecided: "
    "neither, or a run is missing. Interval and p are of a t test over seeds and houses; with one "
    "seed they hold for these weights only."
)

GAINS = (
    "Recovered: (S - arm) / (S - O), S: {silent}, O: {oracle}, over the seeds that all have, with "
    "95 % intervals; no headroom: S - O is not clearly above 0. Protocols: the share of seeds that "
    "beat their silent twin in T_90 and lose the gain with messages zeroed, which "
    "`evaluate intervention=zero` measures."
)


def folder_in(runs: Sequence[str]) -> Path | None:
    """The folder of the study that `runs` name, by its path or name; None where they name runs.

    Raises BadInput where a study stands beside others.
    """
    for text in runs:
        if (RUNS / text / CONFIG).is_file():
            continue
        for folder in (Path(text), RUNS / text, STUDIES / text):
            if (folder / FROZEN).is_file():
                if len(runs) > 1:
                    raise BadInput(f"report: {text} is a study; give it alone")
                return folder
    return None


def main(
    folder: Path,
    out: Path | None = None,
    console: Console | None = None,
    against: str | None = None,
    oracle: str | None = None,
) -> list[Verdict]:
    """Print the rules of the study in `folder`, and write its page, by default report.html there.

    Raises BadInput where the study was changed by hand, `against` is no row, or there is an
    `oracle`, with which a page of runs measures gaps.
    """
    if oracle is not None:
        raise BadInput(f"--oracle {oracle}: is for a page of runs; a study's arms are in its file")
    console = console or output()
    frozen = read_frozen(folder)
    runs = runs_of(frozen)
    verdicts = judge(frozen, runs)
    console.print(as_table("rules", rules_table(verdicts, frozen.study["confidence"])))
    finished = [run for run in runs if run.entries]
    worlds = labelled(gather([str(run.folder) for run in finished]), finished)
    comparisons = [
        compared(key, world, against, frozen.study["baseline"]) for key, world in worlds.items()
    ]
    parts = [part_of(frozen, runs, verdicts), arms_part(frozen)]
    measured, replays = content_of(list(worlds.values()), comparisons) if worlds else ([], [])
    every = [*parts, *gains_of(frozen, worlds, comparisons), *measured]
    origin = origin_of(comparisons)
    page = render(f"Study {folder.name}", notes_of(frozen), every, replays, origin)
    write(out or folder / "report.html", page, console)
    return verdicts


def labelled(worlds: dict[str, World], runs: Sequence[Run]) -> dict[str, World]:
    """The worlds with each setting labelled by its arm, in place."""
    arms = {run.folder.resolve(): run.arm for run in runs}
    for world in worlds.values():
        for setting in world.settings.values():
            setting.label = arms[next(iter(setting.folders.values())).resolve()]
    return worlds


def compared(key: str, world: World, against: str | None, baseline: str) -> WorldComparison:
    """One world's rows, compared with `against` or the study's baseline, where it is there."""
    labels = [row.label for row in rows_of(world)]
    if against is None and baseline in labels and len(labels) > 1:
        against = baseline
    return comparison_of(key, world, against, ON_PAGE)


def gains_of(
    frozen: Frozen, worlds: Mapping[str, World], comparisons: Sequence[WorldComparison]
) -> list[Part]:
    """What each arm recovers of the way from the baseline to the oracle, once there are both."""
    study = frozen.study
    if study["oracle"] is None:
        return []
    finished = [f"{frozen.folder}/{study[end]}-s[0-9]*" for end in ("baseline", "oracle")]
    if any(not glob(f"{runs}/{MEASURED}") for runs in finished):
        return []
    statistics = [world.statistics for world in comparisons]
    add_gains(list(worlds.values()), statistics, *finished)
    rows = [row for rows in statistics for row in rows if "recovered" in row]
    titles, *cells = gain_cells(rows)
    table = [["arm", *titles], *([row["row"], *own] for row, own in zip(rows, cells, strict=True))]
    text = GAINS.format(silent=study["baseline"], oracle=study["oracle"])
    return [Part("Recovered", text, [("Recovered", table)])]


def part_of(frozen: Frozen, runs: Sequence[Run], verdicts: Sequence[Verdict]) -> Part:
    """The rules with their outcomes, and every registered run."""
    confidence = frozen.study["confidence"]
    counts = {state: sum(run.state is state for run in runs) for state in State}
    listed = ", ".join(f"{count} {state.value}" for state, count in counts.items() if count)
    tables = [
        ("Rules", rules_table(verdicts, confidence)),
        (f"Runs: {listed} of {len(runs)}", runs_table(runs, frozen.study["measure"])),
    ]
    return Part("Rules", RULES.format(alpha=round(1 - confidence, 10)), tables)


def arms_part(frozen: Frozen) -> Part:
    """What was registered, in the words of the preset."""
    rows = [["arm", "settings"]]
    rows += [[arm, " ".join(own) or NONE] for arm, own in frozen.study["arms"].items()]
    study = frozen.study
    words = {
        "seeds": ", ".join(map(str, study["seeds"])),
        "budget": study["budget"],
        "houses": study["houses"],
        "measure": study["measure"],
        "baseline": study["baseline"],
        "oracle": study["oracle"],
    }
    listed = "; ".join(f"{key}: {value}" for key, value in words.items() if value is not None)
    return Part("Registered", f"{listed}.", [("Arms", rows)])


def notes_of(frozen: Frozen) -> list[str]:
    """The question, when and by which version the study was frozen, and what the tables hold."""
    content = frozen.content
    by = f"marl-clean {content['version']}" + (
        f", commit {content['commit']}" if content["commit"] else ""
    )
    first = f"Preset {content['preset']}, frozen {content['frozen']} by {by}."
    question = frozen.study["question"]
    return [*([str(question)] if question else []), first, NOTE]


def rules_table(verdicts: Sequence[Verdict], confidence: float) -> Rows:
    """A row for each rule; the first row holds titles."""
    titles = [
        "rule",
        "says",
        "outcome",
        f"estimate [{100 * confidence:g} %]",
        "p",
        "p (Holm)",
        "seeds",
        "missing",
    ]
    return [
        titles,
        *(
            [
                verdict.rule.name,
                verdict.rule.says,
                verdict.outcome.value,
                estimate_of(verdict.effect),
                NONE if verdict.effect is None else p_of(verdict.effect.p),
                p_of(verdict.p_holm),
                str(len(verdict.seeds)),
                ", ".join(verdict.missing) or NONE,
            ]
            for verdict in verdicts
        ),
    ]


def runs_table(runs: Sequence[Run], measure: str) -> Rows:
    """A row for each registered run: its mean of the study's measure, or why there is none."""
    rows = [["run", "arm", "seed", "state", f"mean {measure}", "why"]]
    for run in runs:
        mean = NONE
        if run.entries:
            row = Row(run.arm, {run.seed: run.own})
            mean = f"{values(row, [run.seed], measure).mean():.4g}"
        rows.append(
            [run.folder.name, run.arm, str(run.seed), run.state.value, mean, run.reason or NONE]
        )
    return rows


def estimate_of(item: Effect | None) -> str:
    """`value [low, high]`; a dash where there is none."""
    if item is None or item.value is None:
        return NONE
    if item.interval is None:
        return f"{item.value:.4g} [unbounded]"
    low, high = item.interval
    return f"{item.value:.4g} [{low:.4g}, {high:.4g}]"


def p_of(p: float) -> str:
    """A p-value; tiny ones by their bound."""
    return "< 0.0001" if p < 0.0001 else f"{p:.4f}"


def as_table(title: str, rows: Rows) -> Table:
    """Rows as a table in the terminal; the first holds titles."""
    table = Table(title=title, box=box.SIMPLE_HEAD)
    for name in rows[0]:
        table.add_column(name, overflow="fold")
    for row in rows[1:]:
        table.add_row(*map(Text, row))
    return table
