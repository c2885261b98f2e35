"""Jobs of a sweep on a Ray cluster, by Ray's own API.

Not by `hydra-ray-launcher`: its last release wants cloudpickle below 3.
"""

import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore

from marl_clean.config.installed import is_installed
from marl_clean.errors import BadInput

Task = Callable[[Sequence[str]], None]

SAVING_SECONDS = 60.0  # for the jobs of a sweep that is interrupted
ANSWER_SECONDS = 10.0  # for a cluster; Ray itself tries for minutes
TERMINATED = 128 + signal.SIGTERM
LEVEL = "ray"


@dataclass
class RayConf:
    """Keys of `hydra.launcher` under `hydra/launcher=ray`; resources are those of each job.

    Attributes:
        address: of a cluster, `auto` for one on this machine; null: one is begun on this machine.
        num_cpus, num_gpus: that a job waits for. It computes in as many threads as CPUs.
        max_retries: how often a job is begun anew after its worker or node has died.
    """

    _target_: str = f"{__name__}.RayConf"
    address: str | None = None
    num_cpus: float = 1.0
    num_gpus: float = 0.0
    max_retries: int = 3


def offer_ray() -> None:
    """Add the launcher `ray` to Hydra's, where Ray is installed."""
    if is_installed("ray"):
        group = {"group": "hydra/launcher", "name": LEVEL, "provider": "marl_clean"}
        ConfigStore.instance().store(node=RayConf, **group)


def launch_on_ray(
    task: Task, jobs: Sequence[Sequence[str]], config: RayConf
) -> list[Exception | None]:
    """Run `task` for the settings of each job, and return what each raised.

    The cluster's machines see this folder, and have this package installed. An interrupt is passed
    on to the jobs, which have a minute to save their states. Raises BadInput where no cluster is.
    """
    if config.address is not None:
        _check_answers(config.address)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no request leaves
    import ray

    dashboard = False if config.address is None else None  # of a cluster that is there already
    terminated = threading.Event()
    of_command = signal.getsignal(signal.SIGTERM)
    ray.init(
        config.address,
        include_dashboard=dashboard,
        log_to_driver=False,
        logging_level=logging.ERROR,
    )
    if in_main_thread := threading.current_thread() is threading.main_thread():
        # Ray's own handler prints a stack and exits with 1; its `get` makes a 1 of any exit code.
        signal.signal(signal.SIGTERM, _terminating(terminated))
    try:
        run = ray.remote(
            num_cpus=config.num_cpus, num_gpus=config.num_gpus, max_retries=config.max_retries
        )(_run)
        pending = [run.remote(os.getcwd(), task, list(job)) for job in jobs]
        try:
            return [_error_of(job) for job in pending]
        except (KeyboardInterrupt, SystemExit):
            for job in pending:
                ray.cancel(job)
            ray.wait(pending, num_returns=len(pending), timeout=SAVING_SECONDS)
            if terminated.is_set():
                raise SystemExit(TERMINATED) from None
            raise
    finally:
        ray.shutdown()
        if in_main_thread:
            signal.signal(signal.SIGTERM, of_command)


def _terminating(terminated: threading.Event) -> Callable[..., None]:
    """A handler of SIGTERM that notes it and ends the command."""

    def handler(*_: object) -> None:
        terminated.set()
        sys.exit(TERMINATED)

    return handler


def _check_answers(address: str) -> None:
    """Raises BadInput where nothing listens at HOST:PORT; other forms are left to Ray."""
    host, _, port = address.rpartition(":")
    if "/" in address or not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), ANSWER_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise BadInput(f"hydra.launcher.address={address}: no cluster answers: {error}") from None


def _run(folder: str, task: Task, settings: Sequence[str]) -> None:
    os.chdir(folder)  # a worker begins where its cluster did
    task(settings)


def _error_of(job: Any) -> Exception | None:
    import ray

    try:
        ray.get(job)
    except Exception as error:  # whatever the job raised, or Ray's own when its worker died
        return error
    return None
