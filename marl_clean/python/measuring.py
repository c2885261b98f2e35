"""What the functions and the run object of the Python interface share."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from marl_clean import build
from marl_clean.commands import checks, evaluate
from marl_clean.config.stored import compose_for_policy
from marl_clean.evaluation.interventions import named
from marl_clean.evaluation.records import write_entries
from marl_clean.python.table import Table


def config_for_policy(overrides: Sequence[str]) -> DictConfig:
    """The checked config of `checkpoint`'s run, or of the default, with `overrides` on top.

    Raises BadInput as the commands do.
    """
    config = compose_for_policy(overrides)
    checks.check_all(config)
    return config


def measure(overrides: Sequence[str], intervention: str | Sequence[str] | None) -> Table:
    """Measure what `overrides` describe. Raises BadInput as `marl-clean evaluate` does."""
    config = config_for_policy(overrides)
    text = intervention if isinstance(intervention, str | None) else ",".join(intervention)
    checks.check_intervention(config, text)
    if config.out is not None:
        checks.check_out(Path(config.out))
    entries = evaluate.measured(config, named(text) if text else ())
    if config.out is not None:
        write_entries(Path(config.out), entries)
    return Table(entries)


def env_of(overrides: Sequence[str]) -> TransformedEnv:
    """The env that `overrides` describe; a run's also holds what its policy carries."""
    config = config_for_policy(overrides)
    env = build.make_env(config)
    return env if config.checkpoint is None else build.ready_for_policy(config, env)
