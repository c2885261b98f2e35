"""Do messages matter? One checkpoint on the same houses, with its messages intact and changed."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from omegaconf import DictConfig
from rich import box
from rich.table import Table

from marl_clean.evaluation.evaluator import OnProgress, in_any_env, measure
from marl_clean.evaluation.intervened import CAPTION, MARK, listening_cells, name_of
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
        label = f"{name}{MARK}{intervention}"
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
    rows = [Row(name_of(entry), {0: entry}) for entry in changed]
    summary = untouched["listening"]
    table = Table(
        title="listening: what replaced messages would change, in untouched episodes",
        caption=CAPTION.format(**summary),
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    titles, *lines = listening_cells(summary)
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)
    for line in lines:
        table.add_row(*line)
    return [make_paired_table(differences(rows, reference), reference), table]
