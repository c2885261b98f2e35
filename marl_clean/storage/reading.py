"""Files from outside: ordinary ones of bounded size, and JSON of bounded, finite values.

JSON is read as it is defined (RFC 8259), which knows no NaN and no infinity. What Python's reader
takes beyond that would only fail later: whole numbers of any length, the same key twice, halves of
surrogate pairs, brackets as deep as its stack.
"""

import errno
import json
import math
import os
import re
import stat
from collections import Counter
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from marl_clean.errors import BadInput

DEEPEST = 100  # brackets inside brackets
MOST_VALUES = 2_000_000  # of a file of measures: those of 10,000 houses, ours and three planners'
LONGEST_WHOLE = 20  # characters, the sign included: 64 bits
SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


class TooLarge(BadInput):
    """A file with more bytes than one of its kind may have."""


def read_bytes(path: Path, largest: int) -> bytes:
    """The whole content of a file.

    Raises BadInput where it is no ordinary file (a pipe may never end), is larger than `largest`
    bytes or cannot be read.
    """
    try:
        with open_ordinary(path) as file:
            content = file.read(largest + 1) if os.fstat(file.fileno()).st_size <= largest else None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from error
    if content is None or len(content) > largest:
        raise TooLarge(f"{path}: larger than {largest:,} bytes, the most that is read")
    return content


def open_ordinary(path: Path) -> BinaryIO:
    """Open a file to read it. Raises OSError, also for what is no ordinary file."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "no ordinary file", str(path))
    return path.open("rb")


def parse_json(content: bytes, most_values: int = MOST_VALUES) -> Any:
    """The tree in a JSON text.

    Raises ValueError, with the reason in a few words, where it is none, holds more than
    `most_values` values, or one that is not finite, longer than 64 bits or no text of Unicode.
    """
    if sum(map(content.count, (b",", b"[", b"{"))) > most_values:
        raise ValueError(f"holds more than {most_values:,} values")
    try:
        tree = DECODER.decode(content.decode("utf-8"))
    except RecursionError as error:
        raise ValueError(f"is nested more than {DEEPEST} deep") from error
    if _is_deeper(tree):
        raise ValueError(f"is nested more than {DEEPEST} deep")
    if SURROGATE.search(content):
        json.dumps(tree, ensure_ascii=False).encode("utf-8")  # raises for half of a pair
    return tree


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is beyond the range of numbers")
    return value


def _whole(text: str) -> int:
    if len(text) > LONGEST_WHOLE:
        raise ValueError(f"{text[:20]}... is longer than a whole number of 64 bits")
    return int(text)


def _refused(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of these pairs. Raises ValueError for a key that stands there twice."""
    result = dict(pairs)
    if len(result) < len(pairs):
        [(twice, _)] = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"the key {twice[:20]!r} stands twice")
    return result


def _is_deeper(tree: Any) -> bool:
    """Whether lists and objects lie more than DEEPEST deep in each other."""
    level = [tree]
    for _ in range(DEEPEST):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return False
    return True


DECODER = json.JSONDecoder(
    parse_float=_finite, parse_int=_whole, parse_constant=_refused, object_pairs_hook=_unique
)
