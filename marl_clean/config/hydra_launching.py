"""Hydra's launchers: which there are, whether their settings are right, and jobs handed to one."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from hydra._internal.callbacks import Callbacks
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.core.utils import JobStatus
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from marl_clean.config import _ray
from marl_clean.config.hydra_adapter import Override, first_line, hydra_here
from marl_clean.config.schema import choices
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput

LAUNCHER = "hydra/launcher"
LAUNCHERS = {  # what to install for those that do not come with Hydra
    "joblib": "'marl-clean[sweep]'",
    "ray": "'marl-clean[ray]'",
    "rq": "hydra-rq-launcher",
    "submitit_local": "'marl-clean[slurm]'",
    "submitit_slurm": "'marl-clean[slurm]'",
}

LAUNCHING = "launching"  # a config without the rooms: each job composes its own

_ray.offer_ray()
ConfigStore.instance().store(
    name=LAUNCHING,
    node={
        "defaults": [
            {"override hydra/job_logging": "none"},
            {"override hydra/hydra_logging": "none"},
        ],
        "job": 0,
        "hydra": {
            "output_subdir": None,
            "sweep": {"dir": str(RUNS), "subdir": "."},
            "job": {"name": "marl-clean", "chdir": False},
        },
    },
    provider="marl_clean",
)


def check_launching(overrides: Sequence[Override]) -> None:
    """Raises BadInput where settings of Hydra's own name a level or key that does not exist."""
    if not overrides:
        return
    with hydra_here() as hydra:
        for override in overrides:
            if override.is_sweep:
                raise BadInput(f"{override.key}: is Hydra's own and takes one value")
            if "/" in override.key:
                _check_level(override, hydra.config_loader.get_group_options(override.key))
        levels = [override for override in overrides if "/" in override.key]
        if len(levels) < len(overrides):
            known: Any = _for_launching(hydra, levels)
            for override in overrides:
                if "/" not in override.key:
                    _check_key(override.key, known)
        _for_launching(hydra, overrides)


def launchers() -> list[str]:
    """The launchers that are installed."""
    with hydra_here() as hydra:
        return list(hydra.config_loader.get_group_options(LAUNCHER))


def launch(
    task: Callable[[Sequence[str]], None],
    jobs: Sequence[Sequence[str]],
    overrides: Sequence[Override],
) -> list[Exception | None]:
    """Run `task` for every job's settings, by the launcher that `overrides` choose and set.

    Hydra hands over the number of a job alone: it would compose a whole config for each. Return
    what each job raised. Raises what the launcher itself does, as where a worker was killed.
    """
    with hydra_here() as hydra:
        config = _for_launching(hydra, overrides)
        chosen = OmegaConf.to_object(config.hydra.launcher)
        if isinstance(chosen, _ray.RayConf):
            return _ray.launch_on_ray(task, jobs, chosen)
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=HydraContext(hydra.config_loader, Callbacks(config)),
            task_function=partial(_hydra_job, task, jobs),
            config=config,
        )
        numbers = [[f"job={number}"] for number in range(len(jobs))]
        results = launcher.launch(numbers, initial_job_idx=0)
    failed = (result.status is JobStatus.FAILED for result in results)
    return [r._return_value if f else None for r, f in zip(results, failed, strict=True)]


def _hydra_job(
    task: Callable[[Sequence[str]], None], jobs: Sequence[Sequence[str]], launched: DictConfig
) -> None:
    task(list(jobs[launched.job]))


def _for_launching(hydra: Hydra, overrides: Sequence[Override]) -> DictConfig:
    settings = [override.setting for override in overrides]
    try:
        return hydra.compose_config(LAUNCHING, settings, run_mode=RunMode.MULTIRUN)
    except (HydraException, OmegaConfBaseException) as error:
        reason = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
        raise BadInput(f"{' '.join(settings)}: {first_line(reason)}") from None


def _check_level(override: Override, levels: Sequence[str]) -> None:
    if override.value in levels:
        return
    if override.key == LAUNCHER and override.value in LAUNCHERS:
        package = LAUNCHERS[override.value]
        raise BadInput(f"{override.setting}: is not installed; pip install {package}")
    raise BadInput(f"{override.setting}: no such level; {choices(override.text, levels)}")


def _check_key(key: str, known: Any) -> None:
    for part in key.split("."):
        if not isinstance(known, DictConfig):
            return
        if part not in known:
            names = [str(name) for name in known]
            raise BadInput(f"{key}: no such key of Hydra's; {choices(part, names)}")
        known = known._get_node(part)
