"""Signals stop a training where its state can be saved."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any


@dataclass
class Signals:
    """Those of one command.

    Attributes:
        number: of the last that came, or None.
    """

    number: int | None = None


EARLIER = Signals()
"""What came before a training looks for signals, should a library lose the exception of it."""


class Stopped(Exception):
    """A signal came while something ran that may be broken off."""


class Interrupts:
    """Turns SIGTERM and SIGINT into a flag, to be acted on where the run can be saved.

    Attributes:
        signal: the signal that came, or None.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._breakable = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interrupts":
        if threading.current_thread() is threading.main_thread():  # others cannot have handlers
            for number in (signal.SIGTERM, signal.SIGINT):
                self._before[number] = signal.signal(number, self._note)
            self.signal = EARLIER.number
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Let a signal break off what runs inside, by Stopped; outside it only sets the flag."""
        self._breakable = True
        try:
            if self.signal is not None:
                raise Stopped
            yield
        finally:
            self._breakable = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        if self._breakable:
            self._breakable = False
            raise Stopped
