"""The header of a safetensors file, checked before any tensor is read; without torch."""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from marl_clean.storage.reading import open_ordinary, parse_json

BYTES = {
    **{"F64": 8, "F32": 4, "F16": 2, "BF16": 2},
    **{"I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1},
}
METADATA = "__metadata__"
LARGEST_HEADER = 4 << 20
MOST_TENSORS = 20_000
MOST_SIDES = 16
MOST_VALUES = 12 * MOST_TENSORS


@dataclass(frozen=True)
class Held:
    """A tensor in the file: its type, its shape, and where its bytes begin and end."""

    dtype: str
    shape: tuple[int, ...]
    begin: int
    end: int

    @property
    def numel(self) -> int:
        """The number of its values."""
        return math.prod(self.shape)


def read_header(path: Path) -> dict[str, Held]:
    """Every tensor in a safetensors file, by its name.

    Raises OSError, and ValueError where the header is none, or describes other bytes than follow.
    """
    with open_ordinary(path) as file:
        size = os.fstat(file.fileno()).st_size
        length = int.from_bytes(file.read(8), "little")
        if not length <= min(LARGEST_HEADER, size - 8):
            raise ValueError("its header is longer than the file, or than 4 MiB")
        tree = parse_json(file.read(length), MOST_VALUES)
    if not isinstance(tree, dict):
        raise ValueError("its header names no tensors")
    tensors = {name: _held(name, about) for name, about in tree.items() if name != METADATA}
    if len(tensors) > MOST_TENSORS:
        raise ValueError(f"it holds more than {MOST_TENSORS:,} tensors")
    end = 0
    for held in sorted(tensors.values(), key=lambda held: (held.begin, held.end)):
        if held.begin != end:
            raise ValueError("its tensors overlap, or leave a gap")
        end = held.end
    if end != size - 8 - length:
        raise ValueError("its tensors are not as long as the file")
    return tensors


def _held(name: str, about: Any) -> Held:
    match about:
        case {"dtype": str(dtype), "shape": list(shape), "data_offsets": [begin, end]}:
            numbers = [*shape, begin, end]
            if (
                dtype in BYTES
                and len(shape) <= MOST_SIDES
                and all(type(number) is int and number >= 0 for number in numbers)
                and end - begin == BYTES[dtype] * math.prod(shape)
            ):
                return Held(dtype, tuple(shape), begin, end)
    raise ValueError(f"its header does not describe {name[:40]!r}")
