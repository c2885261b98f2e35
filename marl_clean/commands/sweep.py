"""`train -m`: every combination of the settings is a job, handed to one of Hydra's launchers.

A job is its config's hash, which names its folder; it is finished when its result file verifies.
So the same command does what is missing, and no more. Jobs report by what they write into their
folders, and whatever becomes of one, the others go on.
"""

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from marl_clean.commands._ending import Ending, print_endings
from marl_clean.commands._job import KILLED, MOST_DEATHS, note_failure, train_job
from marl_clean.commands._live import Watch, labels_of
from marl_clean.commands._stopping import workers_end_too
from marl_clean.commands.checks import check_all
from marl_clean.commands.run_info import FAILED, LOG, is_finished
from marl_clean.config.config_hash import config_hash
from marl_clean.config.hydra_adapter import Override, first_line
from marl_clean.config.hydra_launching import LAUNCHER, check_launching, launch, launchers
from marl_clean.config.levels import EXPERIMENT, level_file
from marl_clean.config.locate import named_plugins
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.presets import sweep_of
from marl_clean.config.stored import RUNS, parsed_for_training
from marl_clean.errors import BadInput
from marl_clean.storage.lock import holder

IN_TURN, JOBLIB = "basic", "joblib"
ON_THIS_MACHINE = (IN_TURN, JOBLIB)  # launchers
SETTLE_SECONDS = 0.5
CLOCK_SECONDS = 0.1  # that the times of files may lag behind


@dataclass(frozen=True)
class Job:
    """One job: its settings with its name among them, its checked config and its folder."""

    settings: list[str]
    config: DictConfig
    folder: Path

    @property
    def is_finished(self) -> bool:
        """Whether nothing is left to do, as far as can be verified."""
        return is_finished(self.config, self.folder)


def run(overrides: Sequence[str], console: Console | None = None) -> int:
    """Check every job's config, then run what is not finished; print what became of each job.

    Return 0 where all are finished, else 1. Raises BadInput before the first job starts, and where
    the launcher can start none.
    """
    of_jobs, of_hydra = split(overrides)
    jobs = named_jobs(of_jobs, runs_here(of_hydra))
    labels = labels_of({job.config.name: job.settings for job in jobs})
    return run_jobs(jobs, of_hydra, labels, console)


def split(overrides: Sequence[str]) -> tuple[list[Override], list[Override]]:
    """The settings of the jobs, and Hydra's own, which say how jobs are launched.

    Raises BadInput where one of Hydra's names nothing.
    """
    parsed = parse_overrides(overrides, allow_hydra=True)
    of_hydra = [override for override in parsed if override.of_hydra]
    check_launching(of_hydra)
    return [override for override in parsed if not override.of_hydra], of_hydra


def runs_here(of_hydra: Sequence[Override]) -> bool:
    """Whether the launcher that Hydra's settings choose runs jobs on this machine."""
    return set(_launcher_in(of_hydra)) <= set(ON_THIS_MACHINE)


def run_jobs(
    jobs: Sequence[Job],
    of_hydra: Sequence[Override],
    labels: Mapping[str, str],
    console: Console | None = None,
) -> int:
    """Run those of the checked jobs that are not finished; print what became of each.

    `labels`: of each job by its name. Return and raise as `run` does.
    """
    if not _launcher_in(of_hydra):
        of_hydra = [*of_hydra, *default_launcher([job.config for job in jobs])]
        check_launching(of_hydra)
    with Watch({job.config.name: job.folder for job in jobs}, labels):
        run_missing(jobs, of_hydra)
    return print_endings([Ending.of(job.config, job.folder) for job in jobs], labels, console)


def _launcher_in(of_hydra: Sequence[Override]) -> list[str]:
    """The launcher that the settings choose, the last of several, or nothing."""
    return [override.value for override in of_hydra if override.key == LAUNCHER][-1:]


def default_launcher(configs: Sequence[DictConfig]) -> list[Override]:
    """Joblib where there are several jobs and cores and it is installed, else none: in turn.

    Jobs on a GPU share its memory, so they run in turn unless a launcher is chosen. Joblib gives
    each job its share of the cores as threads, unless OMP_NUM_THREADS says otherwise.
    """
    on_cpu = all(config.device == "cpu" for config in configs)
    if len(configs) < 2 or not on_cpu or JOBLIB not in launchers():
        return []
    from joblib import cpu_count

    at_once = min(len(configs), cpu_count())
    if at_once < 2:
        return []
    settings = [f"{LAUNCHER}={JOBLIB}", f"hydra.launcher.n_jobs={at_once}"]
    return parse_overrides(settings, allow_hydra=True)


def run_missing(jobs: Sequence[Job], of_hydra: Sequence[Override]) -> None:
    """Run the jobs that are not finished, those of them that other processes train excepted.

    A worker that is killed breaks Joblib's pool; then what is left is launched anew, but not a job
    that was killed too often. Raises BadInput where the launcher starts nothing.
    """
    task = partial(train_job, plugins=named_plugins(), driver=os.getpid())
    left = [job for job in jobs if holder(job.folder) is None and not job.is_finished]
    for job in left:
        (job.folder / FAILED).unlink(missing_ok=True)
    deaths: Counter[Path] = Counter()
    while left:
        began = time.time() - CLOCK_SECONDS
        try:
            with workers_end_too([job.folder for job in left]):
                errors = launch(task, [job.settings for job in left], of_hydra)
        except BadInput:
            raise
        except Exception as error:  # of the launcher, whose libraries raise what they like
            _wait_for_holders(left)
            died = [job for job in left if _began(job, began) and not _ended(job)]
            if not died and not any(_began(job, began) for job in left):
                raise BadInput(f"{LAUNCHER}: starts no job: {first_line(error)}") from error
            for job in died:
                deaths[job.folder] += 1
                if deaths[job.folder] >= MOST_DEATHS:
                    note_failure(job.folder, KILLED, job.settings)
            left = [job for job in left if not _ended(job)]
        else:
            for job, failure in zip(left, errors, strict=True):
                if failure is not None:  # before the job could note it
                    job.folder.mkdir(parents=True, exist_ok=True)
                    note_failure(job.folder, first_line(failure), job.settings)
            return


def _began(job: Job, since: float) -> bool:
    """Whether the job has written into its log since then."""
    try:
        return (job.folder / LOG).stat().st_mtime >= since
    except OSError:
        return False


def _ended(job: Job) -> bool:
    return (job.folder / FAILED).is_file() or job.is_finished


def _wait_for_holders(jobs: Sequence[Job]) -> None:
    """Wait until none of the jobs is trained any more: a launcher may leave before they end."""
    while any(holder(job.folder) for job in jobs):
        time.sleep(SETTLE_SECONDS)


def named_jobs(parsed: Sequence[Override], here: bool = True) -> list[Job]:
    """Each distinct job of a sweep.

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
        settings = [*(override.setting for override in job), f"name={config.name}"]
        jobs[config.name] = Job(settings, config, RUNS / config.name)
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
