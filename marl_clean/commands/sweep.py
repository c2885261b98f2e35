"""`train -m`: every combination of the settings is a job, handed to one of Hydra's launchers."""

from collections.abc import Sequence
from itertools import product

from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig

from marl_clean.commands.checks import (
    check_compile,
    check_device,
    check_house,
    check_old_houses,
    check_plans,
    check_teams,
)
from marl_clean.config.compose import EXPERIMENT, conf_folder, own_hydra, parse_overrides
from marl_clean.config.config_hash import config_hash
from marl_clean.config.fitting import check_fit
from marl_clean.config.presets import sweep_of
from marl_clean.config.stored import RUNS, check_same_run, compose_for_training
from marl_clean.errors import BadInput


def run(overrides: Sequence[str]) -> None:
    """Check every job's config, then run them all, one folder a job.

    Raises BadInput before the first job starts, and afterwards what the first failed job raised.
    """
    parsed = parse_overrides(overrides, hydra_too=True)
    jobs = named_jobs([override for override in parsed if not override.is_hydra_override()])
    launcher_settings = [o.input_line or "" for o in parsed if o.is_hydra_override()]
    with own_hydra():
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        config = hydra.compose_config("config", launcher_settings, run_mode=RunMode.MULTIRUN)
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=HydraContext(hydra.config_loader, Callbacks(config)),
            task_function=train_job,
            config=config,
        )
        for job in launcher.launch(jobs, initial_job_idx=0):
            _ = job.return_value  # raises what the job raised


def named_jobs(parsed: Sequence[Override]) -> list[list[str]]:
    """The settings of each distinct job, its name among them.

    A job is named after its config, so the same command again finds the same folders; a given
    name becomes the folder of the whole sweep. Raises BadInput when a job's config is wrong.
    """
    jobs = {}
    for job in sweep_jobs([*of_preset(parsed), *parsed]):
        config = compose_for_training(job)
        if any(setting.startswith("name=") for setting in job):
            config.name = f"{config.name}/{config_hash(config)[:8]}"
        check_house(config)
        check_fit(config)
        check_plans(config)
        check_teams(config)
        check_old_houses(config)
        check_same_run(config, RUNS / config.name)
        jobs[config.name] = [*job, f"name={config.name}"]
    return list(jobs.values())


def of_preset(parsed: Sequence[Override]) -> list[Override]:
    """What the chosen preset sweeps, but for keys that the settings give values of their own.

    Raises BadInput where one of several presets says a sweep, which would be another's too.
    """
    given = {override.get_key_element() for override in parsed}
    presets = [o for o in parsed if o.key_or_group == EXPERIMENT][-1:]
    names = [
        str(name)
        for o in presets
        for name in (o.sweep_string_iterator() if o.is_discrete_sweep() else [o.value()])
        if name is not None
    ]
    found: dict[str, str] = {}
    for name in names:
        swept = sweep_of(conf_folder() / EXPERIMENT / f"{name}.yaml")
        if swept and len(names) > 1:
            raise BadInput(f"{EXPERIMENT}: {name} is a sweep of its own; give it alone")
        found |= swept
    return parse_overrides([f"{key}={value}" for key, value in found.items() if key not in given])


def sweep_jobs(parsed: Sequence[Override]) -> list[list[str]]:
    """The settings of each job of a sweep: every combination of the values given.

    Raises BadInput on a range that has no end, such as `interval(0, 1)`.
    """
    alternatives: dict[str, list[str]] = {}  # of one key given twice the later counts
    for override in parsed:
        key = override.get_key_element()
        if override.is_discrete_sweep():
            values = list(override.sweep_string_iterator())
        elif override.is_sweep_override():
            raise BadInput(f"{key}: a sweep needs a list of values, such as {key}=1,2,3")
        else:
            values = [override.get_value_element_as_str()]
        alternatives[key] = [f"{key}={value}" for value in values]
    return [list(job) for job in product(*alternatives.values())]


def train_job(composed: DictConfig) -> None:
    """One job of a sweep, in whatever process its launcher chose.

    Its settings are composed anew: a checkpoint's config is none of Hydra's.
    """
    from marl_clean.commands import train

    config = compose_for_training(list(HydraConfig.get().overrides.task))
    check_device(config.device)  # here, since the job's machine may not be the launching one
    check_compile(config)
    train.main(config, RUNS / config.name)
