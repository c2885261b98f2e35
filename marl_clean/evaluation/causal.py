"""Do messages matter? One checkpoint on the same houses, with its messages intact and changed."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from omegaconf import DictConfig
from rich import box
from rich.table import Table

from marl_clean.evaluation.evaluator import OnProgress, in_any_env, measure
from marl_clean.evaluation.interventions import INTERVENTIONS, communicating, intervened
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
    """Yield the untouched entry with `listening`, then one entry for each intervention.

    Each is measured lazily. Those of interventions have `change`: for every measure the
    intervened mean minus the untouched mean, with a paired interval over houses. Houses, starts
    and random actions are the same.
    Raises BadInput where the robots send no messages.
    """
    speaking = communicating(policy, name)
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
    """Every measure's paired difference to the untouched policy."""
    changes = {}
    for name in MEASURES:
        if name in entry["houses"][0] and name in untouched["houses"][0]:
            values, baseline = (sample([e["houses"]], name) for e in (entry, untouched))
            difference = paired_difference(values, baseline)
            interval = None if difference.ci95 is None else list(difference.ci95)
            changes[name] = {"mean": difference.mean, "ci95": interval}
    return changes


def make_causal_tables(entries: Sequence[Entry]) -> list[Table]:
    """What each intervention changed, and how far robots listen."""
    untouched, *changed = entries
    reference = Row("untouched", {0: untouched})
    rows = [Row(entry["policy"].rpartition(" | ")[2], {0: entry}) for entry in changed]
    summary = untouched["listening"]
    table = Table(
        title="listening: what replaced messages would change, in untouched episodes",
        caption=(
            "Robots that hear a message. moved: mean |Q' - Q| over the spread of Q between\n"
            "actions (a shift of all alike changes none); switched: the best action differs;\n"
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
