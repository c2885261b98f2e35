"""What the runs of a frozen study say of its rules.

A run that failed or is missing stays in the list, and a rule that needs it is undecided: to leave
out the seeds that failed would favour the arm that fails.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from marl_clean.commands.frozen import Frozen, run_name
from marl_clean.commands.run_info import State, look
from marl_clean.commands.study_plan import PLANNERS, Rule
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.paired import Row, values
from marl_clean.evaluation.records import MEASURED, Entry, read_entries
from marl_clean.evaluation.rules import Effect, Outcome, decide, effect

OTHER_CONFIG = "another config than the registered one"


@dataclass(frozen=True)
class Run:
    """One registered run: its state, why it has no result, and what it measured beside planners."""

    arm: str
    seed: int
    folder: Path
    state: State
    reason: str = ""
    entries: tuple[Entry, ...] = ()

    @property
    def own(self) -> Entry:
        """What was measured in the run's own test houses."""
        return self.entries[0]

    def of_planner(self, name: str) -> Entry | None:
        """A planner on the same houses."""
        same = ("house_set", "n_agents")
        beside = [entry for entry in self.entries if entry["policy"] == name]
        return next((e for e in beside if all(e[key] == self.own[key] for key in same)), None)


@dataclass(frozen=True)
class Verdict:
    """What a study says of a rule.

    Attributes:
        effect: over the seeds that are there; None where there are none.
        p_holm: after Holm's correction over all rules.
        seeds: that the effect is over.
        missing: the runs without which the rule is not decided.
    """

    rule: Rule
    outcome: Outcome
    effect: Effect | None
    p_holm: float
    seeds: Sequence[int]
    missing: Sequence[str]


def runs_of(frozen: Frozen) -> list[Run]:
    """Every registered run, as its folder shows it."""
    return [_run(frozen, arm, seed, digest) for (arm, seed), digest in frozen.hashes.items()]


def _run(frozen: Frozen, arm: str, seed: int, digest: str) -> Run:
    folder = frozen.folder / run_name(arm, seed)
    info = look(folder, folder.name)
    reason = info.reason or ("" if info.holder is None else f"held by {info.holder}")
    if info.state is not State.FINISHED:
        return Run(arm, seed, folder, info.state, reason)
    try:
        config = load_config(folder)
        if config_hash(DictConfig(config)) != digest:
            return Run(arm, seed, folder, State.FAILED, OTHER_CONFIG)
        entries = read_entries(folder / MEASURED)
    except BadInput as error:
        return Run(arm, seed, folder, State.FAILED, str(error))
    if entries[0]["policy"] != config["name"]:
        return Run(arm, seed, folder, State.FAILED, f"{folder / MEASURED}: is of another run")
    return Run(arm, seed, folder, State.FINISHED, "", tuple(entries))


def judge(frozen: Frozen, runs: Sequence[Run]) -> list[Verdict]:
    """What the runs say of each rule. Runs of one seed are paired, in the same houses."""
    confidence = frozen.study["confidence"]
    effects = [_effect(rule, runs, frozen) for rule in frozen.rules]
    missing = [
        [
            f"{run.folder.name} {run.state.value}"
            for run in runs
            if run.arm in rule.arms and not run.entries
        ]
        for rule in frozen.rules
    ]
    complete = [None if lacks else item for (item, _), lacks in zip(effects, missing, strict=True)]
    decided = decide(complete, confidence)
    return [
        Verdict(rule, outcome, item, p_holm, seeds, lacks)
        for rule, (item, seeds), lacks, (p_holm, outcome) in zip(
            frozen.rules, effects, missing, decided, strict=True
        )
    ]


def _effect(rule: Rule, runs: Sequence[Run], frozen: Frozen) -> tuple[Effect | None, list[int]]:
    """A rule's effect over the seeds of which all its arms have a result, and these seeds."""
    by_arm = {
        arm: {run.seed: run for run in runs if run.arm == arm and run.entries} for arm in rule.arms
    }
    seeds = [seed for seed in frozen.study["seeds"] if all(seed in own for own in by_arm.values())]
    if not seeds:
        return None, []
    sides = {arm: Row(arm, {seed: own[seed].own for seed in seeds}) for arm, own in by_arm.items()}
    if rule.than in PLANNERS:
        planner = by_arm[rule.arm][seeds[0]].of_planner(rule.than)
        if planner is None:
            return None, []
        sides[rule.than] = Row(rule.than, {None: planner})
    samples = {side: values(row, seeds, rule.measure) for side, row in sides.items()}
    baseline = None if rule.than is None else samples[rule.than]
    return effect(rule.claim, samples[rule.arm], baseline, frozen.study["confidence"]), seeds
