"""Finds floor plan files, and reads lines: of bounded size, and a failure is one plain line.

NumPy-free and torch-free.
"""

import difflib
import logging
from functools import cache
from pathlib import Path

from marl_clean.errors import BadInput
from marl_clean.settings import LARGEST_SIDE
from marl_clean.storage.reading import read_bytes

LARGEST_FILE_BYTES = 16 * 2**20
MOST_LINES = LARGEST_SIDE + 4  # rows, and the header of a MovingAI map


def find_plan(path: str, shipped: Path, suffixes: tuple[str, ...]) -> Path:
    """The file at `path`, relative to the working directory, or the shipped one of that name.

    `~` is the home folder. Among shipped files of one name, the earliest of `suffixes` wins.
    Raises BadInput for a missing file, or a name that ends in none of `suffixes`.
    """
    file = _expanded(path)
    if not is_file(file):
        kinds = [shipped.glob(f"*{suffix}") for suffix in reversed(suffixes)]
        names = {each.stem: each for kind in kinds for each in kind}
        if path in names:
            return names[path]
        raise BadInput(f"house.path: no file {path!r}; {_nearest(file, suffixes, list(names))}")
    if file.suffix.lower() not in suffixes:
        raise BadInput(f"house.path: {path!r} does not end on any of {', '.join(suffixes)}")
    return file


@cache
def warn_once(text: str) -> None:
    """Log a warning about a file, once per process however often the file is read."""
    logging.getLogger(__name__).warning("%s", text)


def is_file(file: Path) -> bool:
    """Whether an ordinary file is there; False for a name that no file can have."""
    try:
        return file.is_file()
    except (OSError, ValueError):  # too long, or with a null byte
        return False


def read_lines(file: Path) -> list[bytes]:
    """Lines of an ASCII file without their ends and without blank lines at the end of the file.

    Raises BadInput as `read_bytes` does, for more lines than a house may have rows, and for a
    character that is not ASCII.
    """
    content = read_bytes(file, LARGEST_FILE_BYTES).rstrip(b"\r\n")
    if content.count(b"\n") >= MOST_LINES:
        raise BadInput(f"{file}: more than {LARGEST_SIDE} rows")
    if not content:
        return []
    lines = [line.removesuffix(b"\r") for line in content.split(b"\n")]
    for number, line in enumerate(lines, start=1):
        if not line.isascii():
            column = next(index for index, byte in enumerate(line, start=1) if byte > 127)
            raise BadInput(f"{file}, line {number}, column {column}: not an ASCII character")
    return lines


def _expanded(path: str) -> Path:
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no such user
        return Path(path)


def _nearest(file: Path, suffixes: tuple[str, ...], shipped: list[str]) -> str:
    """A suggestion: a similar name beside it or among shipped floor plans, else what is valid."""
    try:
        beside = [each.name for each in file.parent.iterdir() if each.suffix.lower() in suffixes]
    except (OSError, ValueError):
        beside = []
    close = difflib.get_close_matches(file.name, [*beside, *shipped], n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"valid: a file on {', '.join(suffixes)}, or a shipped plan: {', '.join(shipped)}"
