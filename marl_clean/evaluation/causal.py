"""Do messages matter? One checkpoint, its messages untouched and changed, on the same houses."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from omegaconf import DictConfig
from rich import box
from rich.table import Table

from marl_clean.evaluation.evaluator import OnProgress, in_any_env, measure
from marl_clean.evaluation.interventions import INTERVENTIONS, intervened, talking
from marl_clean.evaluation.listening import listening
from marl_clean.evaluation.paired import Row, differences, make_paired_table
from marl_clean.evaluation.records import MEASURES, Entry, sample
from marl_clean.evaluation.statistics import paired_difference


def intervene(
    cfg: DictConfig,
    policy: Any,
    name: str,
    untouched: Entry,
    interventions: Sequence[str],
    on_progress: OnProgress | None = None,
) -> Iterator[Entry]:
    """Yield the untouched entry with how well is listened, and one for each intervention.

    Each is measured when it is asked for.
    These have `change`: for every measure the intervened mean minus the untouched one, with a
    paired interval over houses. Houses, starts and random actions are the same.
    Raises BadInput where the robots say nothing.
    """
    speaking = talking(policy, name)
    epsilon = cfg.evaluation.epsilon
    count = len(untouched["houses"])
    yield {**untouched, "listening": listening(cfg, speaking, count, epsilon)}
    for intervention in interventions:
        changed = intervened(speaking, INTERVENTIONS[intervention])
        label = f"{name} | {intervention}"
        entry = measure(
            cfg,
            partial(in_any_env, changed),
            label,
            epsilon=epsilon,
            seeded=True,
            on_progress=on_progress,
        )
        yield {**entry, "change": change(entry, untouched)}


def change(entry: Entry, untouched: Entry) -> dict[str, Any]:
    """Every measure's paired difference."""
    changes = {}
    for name in MEASURES:
        if name in entry["houses"][0] and name in untouched["houses"][0]:
            ours, theirs = (sample([one["houses"]], name) for one in (entry, untouched))
            difference = paired_difference(ours, theirs)
            interval = None if difference.ci95 is None else list(difference.ci95)
            changes[name] = {"mean": difference.mean, "ci95": interval}
    return changes


def make_causal_tables(entries: Sequence[Entry]) -> list[Table]:
    """What each intervention changed, and how well is listened."""
    untouched, *changed = entries
    reference = Row("untouched", {0: untouched})
    rows = [Row(entry["policy"].rpartition(" | ")[2], {0: entry}) for entry in changed]
    summary = untouched["listening"]
    table = Table(
        title="listening: what replaced messages would do, untouched play",
        caption=(
            "Of robots that hear somebody. moved: mean |Q' - Q| over the spread of Q between\n"
            "actions (a shift of all alike changes none); switched: the best action is another;\n"
            f"kl, cic: nats, softmax at temperature {summary['temperature']}; cic: information\n"
            f"between message and action, over {summary['messages']} messages."
        ),
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    columns = ("moved", "switched", "kl")
    for title in ("replaced by", *columns, "cic"):
        table.add_column(title, justify="right", no_wrap=True)
    for index, name in enumerate(("zero", "shuffle")):
        cells = [_cell(summary[f"{name}_{column}"]) for column in columns]
        table.add_row(name, *cells, _cell(summary["cic"]) if index else "")
    return [make_paired_table(differences(rows, reference), reference), table]


def _cell(estimated: dict[str, Any]) -> str:
    if estimated["mean"] is None:
        return "-"
    low, high = estimated["ci95"]
    return f"{estimated['mean']:.3f} [{low:.3f}, {high:.3f}]"
