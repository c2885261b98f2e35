"""Damaged and hostile checkpoints: `python -m tests.reliability.damage --trials 100`.

A damaged file of the newest checkpoint is noticed by its manifest, and the one before is taken
with one line in the log. A file that a stranger made, with a manifest that holds, is refused.
"""

import argparse
import json
import logging
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from marl_clean.errors import BadInput
from marl_clean.storage.checkpoint import FOLDER, Checkpoints, load_weights
from marl_clean.storage.manifest import MANIFEST, STATE, TENSORS
from tests.reliability.formats import network, seal_checkpoints

KINDS = ("truncate", "flip", "delete")


def damage(path: Path, kind: str, draw: random.Random) -> None:
    """Truncate, change one bit of, or delete one of the three files of a checkpoint."""
    file = draw.choice(sorted(path.iterdir()))
    content = bytearray(file.read_bytes())
    if kind == "truncate":
        file.write_bytes(content[: draw.randrange(len(content))])
    elif kind == "flip":
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        file.write_bytes(content)
    else:
        file.unlink()


class Lines(logging.Handler):
    """Keeps what is logged."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def check_damage(trials: int, kinds: tuple[str, ...] = KINDS) -> None:
    """Damage the newest of two checkpoints. Raises AssertionError where that is not noticed."""
    logger, lines = logging.getLogger("marl_clean.storage.checkpoint"), Lines()
    logger.addHandler(lines)
    try:
        with tempfile.TemporaryDirectory() as folder:
            checkpoints = Checkpoints(Path(folder))
            for frames in (1, 2):
                checkpoints.save("state", frames, {"x": torch.full((50,), float(frames))}, {})
            newest = Path(folder) / "state-000000000002"
            whole = {file: file.read_bytes() for file in newest.iterdir()}
            for kind in kinds:
                draw = random.Random(kind)
                for trial in range(trials):
                    damage(newest, kind, draw)
                    lines.lines.clear()
                    taken = checkpoints.newest("state")
                    assert taken is not None and taken.frames == 1, f"{kind} {trial} is not noticed"
                    assert len(lines.lines) == 1 and "\n" not in lines.lines[0], lines.lines
                    for file, content in whole.items():
                        file.write_bytes(content)
            last = checkpoints.newest("state")
            assert last is not None and last.frames == 2
    finally:
        logger.removeHandler(lines)


def header_of(tree: Any, tail: int = 4) -> bytes:
    """A safetensors file with this header before `tail` bytes."""
    text = tree if isinstance(tree, bytes) else json.dumps(tree).encode()
    return len(text).to_bytes(8, "little") + text + bytes(tail)


def tensor(shape: Any = (1,), offsets: Any = (0, 4), dtype: str = "F32") -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": offsets}


def state_of(tree: str, frames: str = "1", notes: str = "{}") -> bytes:
    return f'{{"frames":{frames},"notes":{notes},"tree":{tree}}}'.encode()


X = '{"channels_last":false,"tensor":"x"}'
STATES = {
    "empty": b"",
    "list": b"[]",
    "object": b"{}",
    "null": b"null",
    "deep lists": b"[" * 5000,
    "deep objects": b'{"a":' * 5000,
    "deep tree": state_of('{"list":[' * 60 + X + "]}" * 60),
    "no tree": b'{"frames":1,"notes":{}}',
    "frames text": state_of(X, frames='"x"'),
    "frames infinite": state_of(X, frames="Infinity"),
    "frames 1e999": state_of(X, frames="1e999"),
    "frames negative": state_of(X, frames="-1"),
    "frames long": state_of(X, frames="9" * 5000),
    "notes number": state_of(X, notes="3"),
    "notes NaN": state_of(X, notes='{"a":NaN}'),
    "surrogate": state_of(X, notes='{"a":"\\ud800"}'),
    "key twice": state_of(X, notes='{"a":1,"a":2}'),
    "absent tensor": state_of('{"tensor":"absent","channels_last":false}'),
    "tensor twice": state_of(f'{{"list":[{X},{X}]}}'),
    "tensor left out": state_of("null"),
    "channels last": state_of('{"tensor":"x","channels_last":true}'),
    "pickle": state_of('{"pickle":"gASV"}'),
    "half a pair": state_of('{"dict":[[1]]}'),
    "list as key": state_of(f'{{"dict":[[[],{X}]]}}'),
    "numbers in a TensorDict": state_of('{"tensordict":[[1,2]],"batch_size":[]}'),
    "batch of text": state_of(f'{{"tensordict":[["x",{X}]],"batch_size":["a"]}}'),
    "batch too large": state_of(f'{{"tensordict":[["x",{X}]],"batch_size":[{10**15}]}}'),
    "negative batch": state_of(f'{{"tensordict":[["x",{X}]],"batch_size":[-1]}}'),
    "another batch": state_of(f'{{"tensordict":[["x",{X}]],"batch_size":[7]}}'),
    "millions of lists": state_of('{"list":[' + "[]," * 2_000_000 + X + "]}"),
    "not UTF-8": b"\xff\xfe{}",
}
HEADERS = {
    "empty": b"",
    "pickle": b"\x80\x04K*.",
    "zip": b"PK\x03\x04" * 10,
    "longer than the file": b"\xff" * 8,
    "list": header_of([]),
    "50,000 brackets": header_of(b"[" * 50_000),
    "huge shape": header_of({"x": tensor([2**62])}),
    "hundred sides": header_of({"x": tensor([1] * 100)}),
    "negative shape": header_of({"x": tensor([-1])}),
    "shape of a float": header_of({"x": tensor([1.0])}),
    "shape of true": header_of({"x": tensor([True])}),
    "unknown type": header_of({"x": tensor(dtype="F7")}),
    "outside of the file": header_of({"x": tensor([2], [0, 8])}),
    "bytes left": header_of({"x": tensor()}, tail=8),
    "gap": header_of({"x": tensor(), "y": tensor(offsets=[8, 12])}, tail=12),
    "overlap": header_of({"x": tensor(), "y": tensor()}),
    "name twice": header_of(b'{"x":%s,"x":%s}' % ((json.dumps(tensor()).encode(),) * 2)),
    "infinite offset": header_of(b'{"x":{"dtype":"F32","shape":[1],"data_offsets":[0,Infinity]}}'),
    "100,000 tensors": header_of({f"{i}": tensor([0], [0, 0]) for i in range(100_000)}, tail=0),
    "other names": header_of({"y": tensor()}),
}
MANIFESTS = {
    "schema NaN": b'{"schema": NaN}',
    "schema 2": b'{"files":{},"schema":2}',
    "5 MB": b" " * 5_000_000,
    "brackets": b"[" * 4000,
    "text": b"whole",
}


def _written(name: str, content: bytes, sealed: bool = True) -> Callable[[Path], None]:
    def write(run: Path) -> None:
        [checkpoint] = (run / FOLDER).iterdir()
        (checkpoint / name).write_bytes(content)
        if sealed:
            seal_checkpoints(run)

    return write


def _sparse(run: Path) -> None:
    """Tensors of a tebibyte, which take no room on the disk."""
    [checkpoint] = (run / FOLDER).iterdir()
    os.truncate(checkpoint / TENSORS, 1 << 40)


def _pipe(run: Path) -> None:
    [checkpoint] = (run / FOLDER).iterdir()
    (checkpoint / STATE).unlink()
    os.mkfifo(checkpoint / STATE)


def _link(run: Path) -> None:
    [checkpoint] = (run / FOLDER).iterdir()
    (checkpoint / STATE).rename(run / "elsewhere.json")
    (checkpoint / STATE).symlink_to(run / "elsewhere.json")


HOSTILE: dict[str, Callable[[Path], None]] = {
    **{f"state: {name}": _written(STATE, content) for name, content in STATES.items()},
    **{f"tensors: {name}": _written(TENSORS, content) for name, content in HEADERS.items()},
    **{f"manifest: {name}": _written(MANIFEST, text, False) for name, text in MANIFESTS.items()},
    "tensors of a tebibyte": _sparse,
    "a pipe": _pipe,
    "a link": _link,
}


def read_hostile(name: str, run: Path) -> None:
    """Hand a hostile checkpoint to the reader of weights. Raises what that raises."""
    Checkpoints(run / FOLDER).save("best", 1, {"x": torch.zeros(1)}, {})
    HOSTILE[name](run)
    load_weights(run, network())


def check_hostile() -> None:
    """Raises AssertionError where a hostile checkpoint is read."""
    for name in HOSTILE:
        with tempfile.TemporaryDirectory() as folder:
            try:
                read_hostile(name, Path(folder))
            except BadInput as error:
                assert "\n" not in str(error)
            else:
                raise AssertionError(f"{name}: is read")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100, help="of each kind of damage")
    trials = parser.parse_args().trials
    logging.getLogger("marl_clean").propagate = False
    began = time.monotonic()
    check_damage(trials)
    check_hostile()
    sys.stdout.write(
        f"checkpoints: {trials} truncated, {trials} with a bit flipped, {trials} with a file gone:"
        f" 0 unnoticed, the one before taken with one line; {len(HOSTILE)} hostile ones: 0 read;"
        f" {time.monotonic() - began:.0f} s\n"
    )


if __name__ == "__main__":
    main()
