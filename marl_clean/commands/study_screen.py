"""What is said of a study before it is run: whether there is anything to win, and unequal arms."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from omegaconf import DictConfig

from marl_clean.config.compose import has_houses
from marl_clean.evaluation.paired import FINISHED
from marl_clean.evaluation.records import Entry, sample
from marl_clean.evaluation.statistics import paired_difference

HOUSES = 50
UNEQUAL = 1.1
MORE_IS_BETTER = ("coverage", "coverage_auc", "spill_cleaned", "balance", "return")


def nothing_to_win(study: Mapping[str, Any], configs: Mapping[str, DictConfig]) -> str | None:
    """Return a line where a planner gains nothing by what the study's oracle knows, else None.

    `configs`: of one run of each arm. The planner of each plays the same 50 validation houses from
    the same starts, and gains where the study's measure is better by its 95 % interval. Without an
    oracle, without houses, or of a measure that planners do not have, there is nothing to screen.
    """
    silent, oracle, measure = study["baseline"], study["oracle"], study["measure"]
    if (
        oracle is None
        or measure == FINISHED
        or not all(has_houses(configs[arm]) for arm in (silent, oracle))
    ):
        return None
    entries = [_by_planner(configs[arm]) for arm in (silent, oracle)]
    if any(measure not in entry["houses"][0] for entry in entries):
        return None
    before, after = (sample([entry["houses"]], measure) for entry in entries)
    policy = entries[0]["policy"]
    if np.array_equal(before, after, equal_nan=True):
        return (
            f"study.oracle: {policy} has the same {measure} in arms {silent} and {oracle} in every"
            f" one of {HOUSES} validation houses: nothing to win, or nothing that a planner uses"
        )
    sign = -1 if measure in MORE_IS_BETTER else 1
    gain = paired_difference(sign * before, sign * after)
    if gain.ci95 is not None and gain.ci95[0] > 0:
        return None
    numbers = "no value" if gain.ci95 is None else f"{before.mean():.2f} and {after.mean():.2f}"
    return (
        f"study.oracle: nothing to win: {measure} of {policy} is {numbers} in arms"
        f" {silent} and {oracle}, not clearly better in {HOUSES} validation houses"
    )


def unequal_sizes(configs: Mapping[str, DictConfig]) -> str | None:
    """Return a line where the arms' networks differ in size by more than a tenth, else None."""
    sizes = {arm: _weights(config) for arm, config in configs.items()}
    least, most = min(sizes, key=sizes.__getitem__), max(sizes, key=sizes.__getitem__)
    if sizes[most] <= UNEQUAL * sizes[least]:
        return None
    return (
        f"study.arms: networks of {sizes[least]:,} weights in {least} and {sizes[most]:,} in"
        f" {most}; parameter_budget={sizes[most]} makes all as large"
    )


def _weights(config: DictConfig) -> int:
    import torch

    from marl_clean import build
    from marl_clean.learning.width import count_weights

    small = copy.deepcopy(config)
    small.train_houses = 1
    with torch.random.fork_rng([]):
        agent = build.make_agent(small, build.make_env(small, num_envs=1))
    return count_weights(agent.network)


def _by_planner(config: DictConfig) -> Entry:
    from marl_clean.evaluation.evaluator import measure_planner
    from marl_clean.evaluation.planner_play import one_thread

    config = copy.deepcopy(config)
    config.evaluation.house_set, config.evaluation.houses = "validation", HOUSES
    with one_thread():
        return measure_planner(config)
