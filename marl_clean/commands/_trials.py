"""What became of the trials of a search: a table, trials.csv, and how to train the best."""

import csv
import io
import shlex
from collections import Counter
from pathlib import Path

from optuna.trial import FrozenTrial, TrialState
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from marl_clean.commands._space import Space
from marl_clean.commands._tune_settings import Measure
from marl_clean.commands._tune_study import Study
from marl_clean.config.locate import named_plugins
from marl_clean.errors import BadInput
from marl_clean.storage import files

TABLE = "trials.csv"
MOST_ROWS, FULL_SEEDS = 20, 5
ORDER = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.RUNNING, TrialState.FAIL)
WORDS = {
    TrialState.COMPLETE: "complete",
    TrialState.PRUNED: "pruned",
    TrialState.RUNNING: "unfinished",
    TrialState.FAIL: "failed",
}


def in_order(study: Study, measure: Measure) -> list[FrozenTrial]:
    """All trials: complete ones, the best first, then those pruned, unfinished and failed."""
    return sorted(
        study.trials(),
        key=lambda t: (ORDER.index(t.state), measure.sign * (value_of(t) or 0.0), t.number),
    )


def value_of(trial: FrozenTrial) -> float | None:
    """A complete trial's value, or the last one that was told of another."""
    if trial.state is TrialState.COMPLETE:
        return trial.value
    return trial.intermediate_values[trial.last_step] if trial.last_step is not None else None


def write_trials(study: Study, measure: Measure, path: Path) -> None:
    """Write trials.csv: a row a trial, in the order of their numbers."""
    keys = [dimension.key for dimension in study.dimensions]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["trial", "state", measure.name, *keys, "runs", "reason"])
    for trial in study.trials():
        value = value_of(trial)
        writer.writerow(
            [
                trial.number,
                WORDS[trial.state],
                "" if value is None else repr(value),
                *(study.text_of(trial, key) for key in keys),
                " ".join(trial.user_attrs.get("runs", [])),
                trial.user_attrs.get("reason", ""),
            ]
        )
    try:
        files.write_file(path, [text.getvalue().encode()])
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from error


def print_trials(study: Study, space: Space, measure: Measure, seeds: int, out: Console) -> int:
    """Print the trials, the best first, and what trains the best; return the exit code."""
    trials = in_order(study, measure)
    failed = [trial for trial in trials if trial.state is TrialState.FAIL]
    shown = trials[:MOST_ROWS] + [t for t in failed if t not in trials[:MOST_ROWS]]
    out.print(make_table(study, measure, shown))
    counts = Counter(WORDS[trial.state] for trial in trials)
    listed = ", ".join(f"{count} {word}" for word, count in counts.items())
    path = study.path.with_name(TABLE)
    out.print(f"{len(trials)} trials: {listed}; all in {path}", soft_wrap=True, highlight=False)
    best = trials[0] if trials and trials[0].state is TrialState.COMPLETE else None
    if best is None:
        return 1
    out.print("the best anew, with seeds that have not chosen it:", highlight=False)
    command = command_of(
        space, {d.key: study.text_of(best, d.key) for d in space.dimensions}, seeds
    )
    out.print(Text(f"  {command}"), soft_wrap=True)
    return 0


def make_table(study: Study, measure: Measure, trials: list[FrozenTrial]) -> Table:
    """A row a trial: its value, its settings, and its run or why it has no value."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("trial", justify="right")
    table.add_column(measure.name, justify="right")
    for title in ("state", "settings", "run"):
        table.add_column(title, overflow="fold")
    for trial in trials:
        value = value_of(trial)
        settings = " ".join(
            f"{dimension.key}={short(study.text_of(trial, dimension.key))}"
            for dimension in study.dimensions
        )
        runs = trial.user_attrs.get("runs", [])
        run = f"{runs[0]} and {len(runs) - 1} more" if len(runs) > 1 else " ".join(runs)
        cells = (
            str(trial.number),
            "-" if value is None else f"{value:.4g}",
            WORDS[trial.state],
            settings,
            trial.user_attrs.get("reason") or run,
        )
        table.add_row(*map(Text, cells))
    return table


def short(text: str) -> str:
    """A number to four digits; any other text as it is."""
    try:
        return text if len(text) < 7 else f"{float(text):.4g}"
    except ValueError:
        return text


def command_of(space: Space, values: dict[str, str], seeds: int) -> str:
    """What trains these values with several seeds, none of which was part of the search."""
    more: dict[str, object] = {}
    if "seed" not in values:
        first = space.config(values).seed + seeds
        more["seed"] = ",".join(str(first + index) for index in range(FULL_SEEDS))
    settings = [override.setting for override in space.overrides(values, **more)]
    presets = [
        f"+{text}" if text.startswith(("experiment=", "budget=")) else text for text in settings
    ]
    plugins = [word for name in named_plugins() for word in ("--plugin", name)]
    return f"marl-clean train -m {shlex.join([*presets, *plugins])}"
