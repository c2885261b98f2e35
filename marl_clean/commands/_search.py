"""The loop of `marl-clean tune`: trials are asked for, run and told, one by one."""

import sys

from rich.console import Console

from marl_clean.commands._trial import run_trial
from marl_clean.commands._trials import TABLE, print_trials, write_trials
from marl_clean.commands._tune_study import Study, alone, pruner_of
from marl_clean.commands.tune import Plan
from marl_clean.storage.lock import Held


def search(plan: Plan, console: Console) -> int:
    """Do what is missing of a search and print its table; 0 where a trial is complete, else 1.

    Raises as `marl_clean.commands.tune.run` does.
    """
    settings, measure = plan.settings, plan.measure
    study = Study(
        plan.folder,
        plan.identity,
        plan.space.dimensions,
        measure.direction,
        settings.seed,
        pruner_of(settings.pruner, settings.prune_after),
    )
    held: set[int] = set()
    try:
        while (number := study.next_trial(settings.trials, held)) is not None:
            try:
                with alone(plan.folder / f"trial-{number}"):
                    work_on(number, study, plan)
            except Held as error:
                held.add(number)
                say(f"trial {number}: left to another process: {error}")
            write_trials(study, measure, plan.folder / TABLE)
    except (SystemExit, KeyboardInterrupt):
        say(f"stopped; the same command goes on with {plan.folder}")
        raise
    write_trials(study, measure, plan.folder / TABLE)
    return print_trials(study, plan.space, measure, settings.seeds, console)


def work_on(number: int, study: Study, plan: Plan) -> None:
    """Finish one trial, unless another process has."""
    trial = study.open_trial(number)
    if trial is None:
        return
    values = " ".join(f"{key}={value}" for key, value in trial.values.items())
    say(f"trial {number} of {plan.settings.trials}: {values}")
    settings = plan.settings
    ended = run_trial(trial, plan.space, plan.measure, settings.seeds, settings.prune_from)
    if ended.value is not None:
        say(f"trial {number}: {plan.measure.name} {ended.value:.4g}")
    else:
        say(f"trial {number}: {'pruned' if ended.pruned else f'failed, {ended.reason}'}")


def say(line: str) -> None:
    """Write one line to stderr."""
    Console(file=sys.stderr, soft_wrap=True).print(line, markup=False, highlight=False)
