"""`train -m`: every combination of the settings is a job, handed to one of Hydra's launchers."""

from collections.abc import Sequence
from functools import partial
from itertools import product

from omegaconf import DictConfig

from marl_clean.commands.checks import check_all
from marl_clean.config.config_hash import config_hash
from marl_clean.config.hydra_adapter import Override, check_launching, launch, settings_of_job
from marl_clean.config.levels import EXPERIMENT, level_file
from marl_clean.config.locate import named_plugins, use_plugins
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.presets import sweep_of
from marl_clean.config.stored import RUNS, compose_for_training, parsed_for_training
from marl_clean.errors import BadInput

ON_THIS_MACHINE = ("basic", "joblib")  # launchers


def run(overrides: Sequence[str]) -> None:
    """Check every job's config, then run them all, one folder a job.

    Raises BadInput before the first job starts, and afterwards the error of the first failed job.
    """
    parsed = parse_overrides(overrides, allow_hydra=True)
    of_hydra = [override for override in parsed if override.of_hydra]
    check_launching(of_hydra)
    launchers = [override.value for override in of_hydra if override.key == "hydra/launcher"]
    here = set(launchers[-1:]) <= set(ON_THIS_MACHINE)
    jobs = named_jobs([override for override in parsed if not override.of_hydra], here)
    launch(partial(train_job, plugins=named_plugins()), jobs, of_hydra)


def named_jobs(parsed: Sequence[Override], here: bool = True) -> list[list[str]]:
    """The settings of each distinct job, its name among them.

    A job is named after its config, so the same command again finds the same folders; a given
    name becomes the folder of the whole sweep. `here`: whether the jobs will run on this machine.
    Raises BadInput when a job's config is wrong.
    """
    jobs = {}
    for job in sweep_jobs([*of_preset(parsed), *parsed]):
        config = parsed_for_training(job)
        if any(override.key == "name" for override in job):
            config.name = f"{config.name}/{config_hash(config)[:8]}"
        check_all(config, training=True, here=here)
        jobs[config.name] = [*(override.setting for override in job), f"name={config.name}"]
    return list(jobs.values())


def of_preset(parsed: Sequence[Override]) -> list[Override]:
    """What the chosen preset sweeps, except for keys that the settings set themselves.

    Raises BadInput where one of several presets has a sweep, which would apply to the others too.
    """
    overridden = {override.key for override in parsed}
    presets = [override for override in parsed if override.key == EXPERIMENT][-1:]
    names = [
        str(name)
        for preset in presets
        for name in (preset.values if preset.is_sweep else [preset.value])
        if name is not None
    ]
    sweep: dict[str, str] = {}
    for name in names:
        swept = sweep_of(level_file(EXPERIMENT, name))
        if swept and len(names) > 1:
            raise BadInput(f"{EXPERIMENT}: {name} is a sweep of its own; give it alone")
        sweep |= swept
    return parse_overrides(
        [f"{key}={value}" for key, value in sweep.items() if key not in overridden]
    )


def sweep_jobs(parsed: Sequence[Override]) -> list[list[Override]]:
    """The settings of each job of a sweep: every combination of the values.

    Raises BadInput on a range that is not a list, such as `interval(0, 1)`.
    """
    alternatives: dict[str, list[Override]] = {}  # the last setting of a key counts
    for override in parsed:
        key = override.key
        if not override.is_sweep:
            alternatives[key] = [override]
        elif override.values:
            alternatives[key] = parse_overrides([f"{key}={value}" for value in override.values])
        else:
            raise BadInput(f"{key}: a sweep needs a list of values, such as {key}=1,2,3")
    return [list(job) for job in product(*alternatives.values())]


def train_job(composed: DictConfig, plugins: Sequence[str] = ()) -> None:
    """One job of a sweep, in whatever process its launcher chose.

    Its settings are composed anew: Hydra does not know a checkpoint's config. They are checked
    again, since the job may run on another machine than the launcher.
    """
    from marl_clean.commands import train

    use_plugins(plugins)
    config = compose_for_training(settings_of_job())
    check_all(config, training=True)
    train.main(config, RUNS / config.name)
