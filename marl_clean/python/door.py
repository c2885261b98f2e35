"""The functions for Python users: the commands, returning what they measured."""

import os
import signal
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from marl_clean import build
from marl_clean.commands import checks
from marl_clean.commands import compare as compare_command
from marl_clean.commands import train as train_command
from marl_clean.config.stored import RUNS, compose_for_training, find_run
from marl_clean.python.keywords import Settings, overrides_of
from marl_clean.python.measuring import env_of, measure
from marl_clean.python.run import Run
from marl_clean.python.table import Table

RunLike = Run | str | os.PathLike[str]
"""A run: the object, its folder, or its name in runs/ or among those that ship."""


def train(settings: Settings = None, /, **keywords: Any) -> Run:
    """Train a policy, measure it on held-out houses beside the planners, and return the run.

    As `marl-clean train` does, into `runs/<name>`; the same call again resumes, or returns the
    finished run. `settings` is a preset by its name or a list of overrides; for keywords see
    `marl_clean.python.keywords.overrides_of`.

        >>> import marl_clean
        >>> run = marl_clean.train(
        ...     "quick", comm="tarmac", n_agents=3, seed=0, name="example",
        ...     num_envs=8, view_size=7, train_houses=8, max_steps=20, houses=2, plans=[],
        ...     total_frames=128, start_frames=64, frames_per_batch=64, batch_frames=16,
        ...     log_interval_frames=64, eval_interval_frames=128,
        ... )  # far too short to learn anything
        >>> run.folder.name, run.config.env.n_agents
        ('example', 3)
        >>> [row["policy"] for row in run.table][:2]
        ['example', 'random']

    Raises:
        BadInput: what `marl-clean train` refuses, in the same words.
        KeyboardInterrupt: after an interrupt, when the state is saved; the same call resumes.
    """
    overrides = overrides_of(settings, keywords)
    checks.check_no_study(overrides)
    config = compose_for_training(overrides)
    checks.check_all(config, training=True)
    folder = RUNS / config.name
    try:
        train_command.main(config, folder, Console(quiet=True))
    except SystemExit as end:
        if (
            end.code == 128 + signal.SIGINT
        ):  # the commands' exit code; Python has an exception for it
            raise KeyboardInterrupt from None
        raise
    return Run(folder)


def evaluate(
    run: RunLike | Sequence[str] | None = None,
    /,
    *,
    intervention: str | Sequence[str] | None = None,
    **keywords: Any,
) -> Table:
    """Measure a run's policy beside the planners, or without a run `planner=`, and return rows.

    As `marl-clean evaluate` does; a file is written only with `out=`. `run` may also be a list of
    overrides. `intervention`: changes of the messages, one name or several, or `all`.

        >>> import marl_clean
        >>> table = marl_clean.evaluate("mine", house="apartment", houses=2, max_steps=30)
        >>> [row["policy"] for row in table]
        ['mine', 'random', 'nearest_unknown', 'nearest_unknown+greedy']
        >>> marl_clean.evaluate("mine", houses=2, intervention="zero")[1]["policy"]
        'mine | zero'

    Raises:
        BadInput: what `marl-clean evaluate` refuses, in the same words.
    """
    if run is None or (isinstance(run, Sequence) and not isinstance(run, str)):
        return measure(overrides_of(run, keywords), intervention)
    return measure(overrides_of(None, {"checkpoint": name_of(run), **keywords}), intervention)


def compare(
    *runs: RunLike,
    against: str | None = None,
    silent: str | None = None,
    oracle: str | None = None,
) -> Table:
    """Pool the seeds of finished runs and return a row for each setting, planners last.

    As `marl-clean compare` does, without its files. `differences` holds each setting's paired
    difference to the row labelled `against`, or to the first without communication, on the same
    houses; `statistics` each row's interquartile means, optimality gaps, profiles and probability
    of improvement, and with `silent` or `oracle` (a row's label, or runs by folder or glob) its
    recovered headroom and its share of protocols.

        >>> import marl_clean
        >>> table = marl_clean.compare("mine", against="nearest_unknown")
        >>> [row["policy"] for row in table][:2]
        ['mine', 'random']
        >>> table.differences[0]["reference"]
        'nearest_unknown'

    Raises:
        BadInput: what `marl-clean compare` refuses, in the same words.
    """
    folders = [name_of(run) for run in runs]
    worlds = compare_command.compared(folders, against, silent, oracle)
    return Table(
        [entry for world in worlds for entry in world.entries],
        [difference for world in worlds for difference in world.differences],
        [row for world in worlds for row in world.statistics],
    )


def make_env(settings: Settings = None, /, **keywords: Any) -> TransformedEnv:
    """Return the TorchRL env of a config, as `marl-clean train` would build it.

    With `checkpoint=` it is the run's own, with what its policy carries; settings may change the
    world around it. For settings and keywords see `train`.

        >>> import marl_clean
        >>> env = marl_clean.make_env(house="open", n_agents=3, num_envs=4)
        >>> env.rollout(5)["next", "agents", "reward"].shape
        torch.Size([4, 5, 3, 1])

    Raises:
        BadInput: a wrong setting.
    """
    return env_of(overrides_of(settings, keywords))


def load_policy(run: RunLike) -> TensorDictModuleBase:
    """Return a run's greedy policy: the best weights on validation houses, on the CPU.

    The env must hold what it carries from step to step: `make_env(checkpoint=RUN)` does, any other
    needs `env.append_transform(policy.make_tensordict_primer())`.

        >>> import marl_clean
        >>> policy = marl_clean.load_policy("approach_2_frontier")
        >>> env = marl_clean.make_env(checkpoint="approach_2_frontier", num_envs=4)
        >>> env.rollout(5, policy)["agents", "action"].shape
        torch.Size([4, 5, 2])

    Raises:
        BadInput: there is no such run, or its files do not fit.
    """
    return build.load_policy(find_run(name_of(run)))


def name_of(run: RunLike) -> str:
    """A run as a command takes it: its folder or name."""
    return str(run.folder) if isinstance(run, Run) else os.fspath(run)
