"""The command that is being carried out, for what is written to say how it was made.

Whoever begins a command names it once (`issued`): the command line, or a job of a sweep, whose
process has a command line of the launcher. Without it, the program of a Python user is named.
"""

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

PROGRAM = "marl-clean"
_ISSUED: ContextVar[str | None] = ContextVar("issued", default=None)


@contextmanager
def issued(words: Sequence[str]) -> Iterator[None]:
    """Within this context `command_line` is `marl-clean` with these words, quoted for a shell."""
    token = _ISSUED.set(shlex.join([PROGRAM, *words]))
    try:
        yield
    finally:
        _ISSUED.reset(token)


def command_line() -> str:
    """Return the command in one line; of a Python program its file's name and arguments."""
    if (command := _ISSUED.get()) is not None:
        return command
    program, *arguments = sys.argv or [""]
    return shlex.join([Path(program).name or "python", *arguments])
