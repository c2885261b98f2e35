"""`marl-clean evaluate`: any policy on any houses, into evaluation.json and a table."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from marl_clean import build
from marl_clean.config.stored import find_run
from marl_clean.evaluation.causal import intervene, make_causal_tables
from marl_clean.evaluation.evaluator import measure_beside_planners, measure_planner
from marl_clean.evaluation.interventions import talking
from marl_clean.evaluation.records import Entry, write_entries
from marl_clean.evaluation.table import make_table, output


def main(
    cfg: DictConfig,
    out: Path,
    console: Console | None = None,
    interventions: Sequence[str] = (),
) -> list[Entry]:
    """Measure `cfg.checkpoint`'s policy beside the planners, or without one `cfg.planner`.

    With `interventions` its messages are changed too, one way after the other.

    Writes the entries to `out`, the policy asked for first, and prints them as a table.
    Raises BadInput where the checkpoint's weights cannot be used.
    """
    if cfg.checkpoint is None:
        entries = [measure_planner(cfg)]
    else:
        policy = build.load_policy(find_run(cfg.checkpoint), cfg.channel).to(cfg.device)
        if interventions:
            talking(policy, cfg.name)
        entries = measure_beside_planners(cfg, policy, cfg.name)
        if interventions:
            own, *planners = entries
            changed = intervene(cfg, policy, cfg.name, own, interventions)
            entries = [*changed, *planners]
    write_entries(out, entries)
    console = console or output()
    console.print(make_table(entries))
    for table in make_causal_tables(changed) if interventions else ():
        console.print(table)
    console.print(f"written to {out}", soft_wrap=True)
    return entries
