"""`marl-clean evaluate`: any policy on any houses, into evaluation.json and a table."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from marl_clean import build
from marl_clean.commands._plan_lines import write_evaluation_lines
from marl_clean.commands._progress import EvaluationProgress
from marl_clean.config.stored import find_run
from marl_clean.evaluation.causal import intervene, make_causal_tables
from marl_clean.evaluation.evaluator import (
    YARDSTICKS,
    OnProgress,
    measure_beside_planners,
    measure_planner,
)
from marl_clean.evaluation.interventions import communicating
from marl_clean.evaluation.records import Entry, write_entries
from marl_clean.evaluation.table import make_table, output


def main(
    cfg: DictConfig,
    out: Path,
    console: Console | None = None,
    interventions: Sequence[str] = (),
) -> list[Entry]:
    """Measure `cfg.checkpoint`'s policy beside the planners, or without one `cfg.planner`.

    With `interventions` it is also measured under each of these changes of its messages.

    Writes the entries to `out` as soon as each is measured, the policy's own first, and prints
    them as a table. Raises BadInput where the checkpoint's weights cannot be used.
    """
    write_evaluation_lines(cfg)
    alone = cfg.checkpoint is None
    with EvaluationProgress(1 if alone else 1 + len(interventions) + len(YARDSTICKS)) as progress:
        entries = measured(cfg, interventions, progress.show, partial(write_entries, out))
    console = console or output()
    console.print(make_table(entries))
    if interventions:
        changed = [entry for entry in entries if "listening" in entry or "change" in entry]
        for table in make_causal_tables(changed):
            console.print(table)
    console.print(f"written to {out}", soft_wrap=True)
    return entries


def measured(
    cfg: DictConfig,
    interventions: Sequence[str] = (),
    on_progress: OnProgress | None = None,
    keep: Callable[[list[Entry]], object] | None = None,
) -> list[Entry]:
    """Return the entries of `cfg.checkpoint`'s policy and the planners, or of `cfg.planner`.

    `keep` is called with all entries so far, after each new one.
    Raises BadInput where the checkpoint's weights cannot be used.
    """
    entries: list[Entry] = []

    def add(entry: Entry) -> None:
        entries.append(entry)
        if keep is not None:
            keep(entries)

    if cfg.checkpoint is None:
        add(measure_planner(cfg, on_progress))
        return entries
    policy = build.load_policy(find_run(cfg.checkpoint), cfg).to(cfg.device)
    if interventions:
        communicating(policy, cfg.name)
    measurements = measure_beside_planners(cfg, policy, cfg.name, on_progress)
    own = next(measurements)
    add(own)
    if interventions:
        entries.clear()  # the policy's own entry is replaced by one that includes its listening
        for entry in intervene(cfg, policy, cfg.name, own, interventions, on_progress):
            add(entry)
    for entry in measurements:
        add(entry)
    return entries
