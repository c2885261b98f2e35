"""Ends Joblib's workers with the sweep that a signal ends, once their jobs' states are saved."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from marl_clean.storage.lock import holder

SAVING_SECONDS = 60.0  # for the jobs of a sweep that is ended
RETURNING_SECONDS = 0.5  # for workers to hand over what became of these jobs
CLOSING_SECONDS = 5.0  # for Joblib, which can wait for ever for a worker killed in mid-message
LOOK_SECONDS = 0.05
ENDING = (signal.SIGTERM, signal.SIGINT)
EXECUTORS = "joblib.externals.loky.reusable_executor"  # the module that knows Joblib's workers


@contextmanager
def workers_end_too(folders: Sequence[Path]) -> Iterator[None]:
    """Pass SIGTERM and SIGINT on to Joblib's workers, then end as the signal would have.

    Joblib kills its workers at once when its driver ends, and states would be lost; and a worker
    without a driver would wait for another for minutes. `folders`: of the jobs, whose locks are
    free when their states are saved.
    """
    before: dict[int, Any] = {}
    last_resort: list[threading.Timer] = []

    def pass_on(number: int, frame: FrameType | None) -> None:
        for each, handler in before.items():  # a second signal does not wait
            signal.signal(each, handler)
        if _end_workers(number, folders):
            last_resort.append(threading.Timer(CLOSING_SECONDS, os._exit, [128 + number]))
            last_resort[0].start()
        if callable(before[number]):
            before[number](number, frame)
        else:
            raise SystemExit(128 + number)

    if threading.current_thread() is threading.main_thread():  # others cannot have handlers
        before |= {each: signal.signal(each, pass_on) for each in ENDING}
    try:
        yield
    finally:
        for timer in last_resort:
            timer.cancel()
        for each, handler in before.items():
            signal.signal(each, handler)


def _end_workers(number: int, folders: Sequence[Path]) -> bool:
    """Signal all workers, wait until the jobs that they train have let go, then kill them.

    Return whether there were any.
    """
    if not (workers := _workers()):
        return False
    held = [folder for folder in folders if holder(folder) is not None]
    _send(number, workers)
    end = time.monotonic() + SAVING_SECONDS
    while any(holder(folder) is not None for folder in held) and time.monotonic() < end:
        time.sleep(LOOK_SECONDS)
    time.sleep(RETURNING_SECONDS)
    _send(signal.SIGKILL, {*workers, *_workers()})
    return True


def _workers() -> set[int]:
    """The processes of Joblib's workers, if it has begun any."""
    executor = getattr(sys.modules.get(EXECUTORS), "_executor", None)
    return set(getattr(executor, "_processes", None) or ())


def _send(number: int, processes: set[int]) -> None:
    for process in processes:
        with suppress(ProcessLookupError):
            os.kill(process, number)
