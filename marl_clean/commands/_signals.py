"""What SIGTERM and SIGINT do to a command, from the first line of the program on.

While it reads its settings and imports torch, nothing is written yet, and an exception in the
middle of an import may be lost or end in a traceback: they end the process at once. When its work
begins they raise, so that what it holds is let go; a training takes them over (`Interrupts`).
"""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any

from marl_clean.trainer._interrupts import EARLIER, Signals

ENDING = (signal.SIGTERM, signal.SIGINT)


def raising(number: int, frame: FrameType | None) -> None:
    EARLIER.number = number
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def end_at_once(number: int, frame: FrameType | None) -> None:
    os._exit(128 + number)


def end_at_once_by_signals() -> None:
    """Let signals end this process at once, until its work begins."""
    for number in ENDING:
        signal.signal(number, end_at_once)


@contextmanager
def handled() -> Iterator[Signals]:
    """Within this context signals raise, unless they end the process at once; then as before."""
    before = {number: signal.getsignal(number) for number in ENDING}
    EARLIER.number = None
    try:
        if before[signal.SIGTERM] is not end_at_once:
            _raise_from_now_on()
        yield EARLIER
    finally:
        EARLIER.number = None
        for number, handler in before.items():
            signal.signal(number, handler)


def begin(command: str) -> Any:
    """Import what a command does; from now on signals raise."""
    module = import_module(f"marl_clean.commands.{command}")
    _raise_from_now_on()
    return module


def _raise_from_now_on() -> None:
    for number in ENDING:
        signal.signal(number, raising)
