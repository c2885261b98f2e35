"""Comparisons, some of which the paper argues for but never ran: each trains what it needs.

`marl-clean figure NAME budget=smoke|small|full seed=0,1,2`: a row is one preset or setting, its
runs are those that `marl-clean train` with the same settings makes, so nothing is trained twice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from marl_clean.commands.checks import check_all
from marl_clean.commands.command_line import command_line
from marl_clean.commands.sweep import sweep_jobs
from marl_clean.config.compose import compose_parsed
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import BUDGET, EXPERIMENT
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput
from marl_clean.storage.lock import Held


@dataclass(frozen=True)
class Comparison:
    """A question, and the rows that answer it: labels and the settings behind them."""

    question: str
    rows: Mapping[str, Sequence[str]]


ANY_HOUSE = ["experiment=any_house", "trainer.imitate=null", "env.wall_pays=1"]
COMPARISONS = {
    "single": Comparison(
        "Does one learning robot beat the walk to the nearest unknown cell? (§3.2)",
        {"one robot": ["experiment=paper_single"]},
    ),
    "approaches": Comparison(
        "One network for all robots, or one each? (§3.4)",
        {
            "approach 1: central controller": ["experiment=paper_central"],
            "approach 2: message, r1 + r2": ["experiment=paper_proximity"],
            "independent: no message, own reward": ["experiment=independent"],
        },
    ),
    "sharing": Comparison(
        "Does it help to share the reward? (§3.4)",
        {
            "each its own": ["experiment=paper_proximity", "reward=individual"],
            "r1 + r2 near each other": ["experiment=paper_proximity"],
            "the team's sum": ["experiment=paper_proximity", "reward=team"],
        },
    ),
    "sensors": Comparison(
        "Distance sensors, or the map in memory? (§3.2)",
        {
            "map around the robot": ["experiment=independent"],
            "8 distance sensors": [
                "experiment=independent",
                "observation=distances",
                "encoder=mlp",
            ],
        },
    ),
    "memory": Comparison(
        "Full ignorance, or a house that the robots know? (§3.4)",
        {
            "unknown": ["experiment=paper_proximity"],
            "memorised": ["experiment=paper_proximity", "env.knowledge=memorised"],
            "memorised, then furniture moved": [
                "experiment=paper_proximity",
                "env.knowledge=stale",
                "env.furniture_moves_before_start=6",
            ],
        },
    ),
    "readings": Comparison(
        "Which reading of the reward can be learnt? (§3.3)",
        {
            "default": ["experiment=paper_proximity"],
            "every cell pays 2 - 2 v": [
                "experiment=paper_proximity",
                "env.uncleaned_at_most=0.499",
            ],
            "an unknown cell counts as 0": ["experiment=paper_proximity", "env.unknown_pays_as=0"],
            "cases exclude each other": ["experiment=paper_proximity", "env.cases=exclude"],
            "every bump pays": ["experiment=paper_proximity", "env.obstacles=every"],
        },
    ),
    "parts": Comparison(
        "What is each part of any_house worth? (Each row changes the second.)",
        {
            "any_house": ["experiment=any_house"],
            "no planner first, walls pay 1": ANY_HOUSE,
            "crop instead of compass": [*ANY_HOUSE, "observation=crop", "encoder=cnn"],
            "frontier instead of compass": [*ANY_HOUSE, "observation=frontier", "encoder=cnn"],
            "walls not masked": [*ANY_HOUSE, "agent.mask_walls=false"],
            "houses of one size": [*ANY_HOUSE, "house.sides=[[10,10]]"],
            "no shaping": [*ANY_HOUSE, "env.shaping=0"],
            "walls pay as cells": [*ANY_HOUSE, "env.wall_pays=2"],
            "walls pay nothing": [*ANY_HOUSE, "env.wall_pays=0"],
            "dirt comes back": [*ANY_HOUSE, "env.decay_steps=200"],
            "the paper's reward": [
                *ANY_HOUSE,
                "env.shaping=0",
                "env.wall_pays=2",
                "env.decay_steps=200",
            ],
            "a planner first": [*ANY_HOUSE, "trainer.imitate=nearest_unknown"],
            "discount 0.95": [*ANY_HOUSE, "agent.gamma=0.95", "agent.gamma_end=null"],
            "PQN instead of PPO": [
                "experiment=any_house_task",
                "env.wall_pays=1",
                "agent=pqn",
                "trainer=on_policy",
                "trainer.epochs=2",
                "trainer.minibatch_frames=512",
            ],
        },
    ),
    "sizes": Comparison(
        "Trained in 10x10 houses, what does a robot see that helps it in others?",
        {
            name: [*ANY_HOUSE, "house.sides=[[10,10]]", *settings]
            for name, settings in {
                "crop": ["observation=crop", "encoder=cnn"],
                "frontier": ["observation=frontier", "encoder=cnn"],
                "compass": [],
            }.items()
        }
        | {"compass, trained in 8 to 20": ANY_HOUSE},
    ),
}


def jobs_of(name: str, settings: Sequence[str]) -> dict[str, list[DictConfig]]:
    """The checked configs behind each row of a comparison, one per seed.

    Raises BadInput where a setting is wrong, or would change what the rows mean.
    """
    keys = {override.key for override in parse_overrides(settings)}
    for key in ("name", "checkpoint", EXPERIMENT):
        if key in keys:
            raise BadInput(f"{key}: figure {name} trains runs of its own; leave it out")
    jobs = {}
    for label, row in COMPARISONS[name].rows.items():
        combined = sweep_jobs(parse_overrides([*row, *settings]))
        jobs[label] = [compose_parsed(job) for job in combined]
        for config in jobs[label]:
            check_all(config, training=True)
    return jobs


def main(name: str, settings: Sequence[str], console: Console | None = None) -> list[Path]:
    """Train what comparison `name` lacks, print its tables, and draw the first into runs/figures.

    There is a table for every set of houses on which all rows were measured. Raises BadInput
    before anything is trained where a setting is wrong, and after all others have been trained
    where another process trains a run of the comparison.
    """
    jobs = jobs_of(name, settings)
    from marl_clean.commands import train
    from marl_clean.commands.compare import tables_of
    from marl_clean.evaluation.records import Entry, write_entries
    from marl_clean.evaluation.table import make_table, output
    from marl_clean.report.axes import save_figure
    from marl_clean.report.comparison import draw_comparison
    from marl_clean.report.origin import Origin

    console = console or output()
    runs: dict[str, list[list[Entry]]] = {label: [] for label in jobs}
    held = []
    for label, configs in jobs.items():
        for config in configs:
            try:
                runs[label].append(train.main(config, RUNS / config.name, console))
            except Held as error:
                held.append(str(error))
    if held:
        more = f" ({len(held)} runs are held)" if len(held) > 1 else ""
        raise BadInput(f"figure {name}: {held[0]}; then the same command again{more}")
    tables = tables_of(runs)
    if not tables:
        raise BadInput(
            f"figure {name}: no houses on which all rows were measured; name some, such as"
            " evaluation.sides=[10,20] or evaluation.plans=[apartment]"
        )
    for rows in tables:
        *_, (_, planner) = rows.values()
        console.print(make_table([*(learned for learned, _ in rows.values()), planner]))
    first = next(iter(jobs.values()))
    title = f"{COMPARISONS[name].question}\n{budget_line(settings, first)}"
    hashes = [config_hash(config) for configs in jobs.values() for config in configs]
    origin = Origin(command_line(), hashes)
    paths = save_figure(draw_comparison(title, tables[0]), RUNS / "figures" / name, origin)
    table = RUNS / "figures" / f"{name}.json"
    write_entries(table, [entry for rows in tables for pair in rows.values() for entry in pair])
    for path in (*paths, table):
        console.print(f"written to {path}", soft_wrap=True)
    return paths


def budget_line(settings: Sequence[str], configs: Sequence[DictConfig]) -> str:
    """The runs' training budget, their number and their number of test houses, in words."""
    budget = [o.value for o in parse_overrides(settings) if o.key == BUDGET]
    config = configs[0]
    return (
        f"budget={budget[-1] if budget else 'as in the presets'}:"
        f" {config.trainer.total_frames:,} frames, {len(configs)} run(s) a row,"
        f" {config.evaluation.houses} houses; 95 % intervals"
    )
