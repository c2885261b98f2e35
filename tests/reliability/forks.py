"""A training in a fork of this process, which can be killed at a chosen moment.

A fork writes a letter into a pipe whenever it begins something else (`PHASES`). So a moment can be
named by what is going on, however busy the machine is.
"""

import multiprocessing
import os
import select
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

from omegaconf import DictConfig

from marl_clean.cli import BAD_INPUT
from marl_clean.commands import train as command
from marl_clean.errors import BadInput
from marl_clean.logger.csv import Csv
from marl_clean.storage import files
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer.base import TrainingLoop
from marl_clean.trainer.off_policy import OffPolicyLoop
from marl_clean.trainer.on_policy import OnPolicyLoop

SAVE, REMOVE = "s", "x"
PHASES = {
    "b": "begin",
    "r": "resume",
    "p": "play",
    "l": "learn",
    "w": "write a row",
    "e": "evaluate",
    SAVE: "save",
    REMOVE: "remove",
    "f": "finish",
}
PATIENCE_SECONDS = 120.0


class Broken(AssertionError):
    """A promise that did not hold."""


@dataclass(frozen=True)
class Moment:
    """So many seconds after a letter was written for the n-th time."""

    letter: str
    nth: int
    seconds: float


class Fork:
    """A training in a fork of this process, which is waited for.

    Args:
        kill: when it is killed; None: it is not.
        within: a context of its own, in which it trains.
        may_refuse: that it ends with bad input is no fault.

    Attributes:
        parts: the letters that it wrote, and the seconds until the next.
        killed: whether the kill came before its end.
        refused: the line with which it ended; empty where it did not end so.

    Raises Broken where it ended otherwise, or does nothing for two minutes.
    """

    def __init__(
        self,
        config: DictConfig,
        folder: Path,
        kill: Moment | None = None,
        within: AbstractContextManager[None] | None = None,
        may_refuse: bool = False,
    ) -> None:
        self.errors = folder.with_suffix(".txt")
        self.pipe, writing = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads that pytest may have
            self.pid = os.fork()
        if not self.pid:
            self._train(config, folder, writing, within or nullcontext())
        os.close(writing)
        letters, times = "", []
        for letter in self._letters():
            letters, times = letters + letter, [*times, time.monotonic()]
            if kill and letter == kill.letter and letters.count(letter) == kill.nth:
                time.sleep(kill.seconds)
                os.kill(self.pid, signal.SIGKILL)
        lasted = (end - begin for begin, end in pairwise([*times, time.monotonic()]))
        self.parts = list(zip(letters, lasted, strict=True))
        os.close(self.pipe)
        _, status = os.waitpid(self.pid, 0)
        code = os.waitstatus_to_exitcode(status)
        self.killed = code == -signal.SIGKILL and kill is not None
        self.refused = self.errors.read_text() if code == BAD_INPUT and may_refuse else ""
        if code and not self.killed and not self.refused:
            raise Broken(f"{folder.name} ends with {code}: {self.errors.read_text()[-2000:]}")

    def _train(
        self, config: DictConfig, folder: Path, pipe: int, within: AbstractContextManager[None]
    ) -> None:
        """Train, in the fork, which never returns."""
        code = 1
        try:
            errors = os.open(self.errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(errors, 2)
            sys.stderr = os.fdopen(errors, "w", buffering=1)
            # Else locks of TorchRL's, which a kill leaves behind, wait for the end of this process.
            multiprocessing.set_start_method("fork", force=True)
            with letters_into(pipe), within:
                train(config, folder)
            code = 0
        except BadInput as error:
            code = BAD_INPUT
            sys.stderr.write(f"{error}\n")
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)

    def _letters(self) -> Iterator[str]:
        while True:
            if not select.select([self.pipe], [], [], PATIENCE_SECONDS)[0]:
                os.kill(self.pid, signal.SIGKILL)
                raise Broken(f"nothing happens for {PATIENCE_SECONDS} s")
            if not (letter := os.read(self.pipe, 1)):
                return
            yield letter.decode()


def train(config: DictConfig, folder: Path) -> None:
    """Train as the command does, or go on."""
    command.train(config, folder, lambda: None)


@contextmanager
def letters_into(pipe: int) -> Iterator[None]:
    """Within this context a letter goes into the pipe whenever something else begins."""
    open_phases = ["b"]

    def telling(letter: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def told(*args: Any, **kwargs: Any) -> Any:
            open_phases.append(letter)
            os.write(pipe, letter.encode())
            try:
                return function(*args, **kwargs)
            finally:
                open_phases.pop()
                os.write(pipe, open_phases[-1].encode())

        return told

    where = [
        *((TrainingLoop, "resume", "r"), (TrainingLoop, "collect", "p")),
        *((OffPolicyLoop, "learn", "l"), (OnPolicyLoop, "learn", "l")),
        *((Csv, "log", "w"), (TrainingLoop, "measure", "e"), (TrainingLoop, "finish", "f")),
        *((Checkpoints, "save", SAVE), (files, "remove_folder", REMOVE)),
    ]
    with ExitStack() as stack:
        for owner, name, letter in where:
            told = telling(letter, getattr(owner, name))
            stack.enter_context(mock.patch.object(owner, name, told))
        os.write(pipe, b"b")
        yield
