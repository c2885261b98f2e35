"""Checkpoints: tensors as safetensors, the rest as JSON, each proven by a manifest of sha256.

A checkpoint is a folder `<kind>-<frames>` of three files:

    tensors.safetensors  every tensor, under its path in the tree
    state.json           kind, frames, notes, and the tree with names in place of tensors
    manifest.json        length and sha256 of the other two

It is written under a fresh name, read again, and only then are older ones pruned. Reading takes
the newest whose manifest holds; nothing is ever unpickled.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage._header import read_header
from marl_clean.storage._trees import decode, encode
from marl_clean.storage.finite import Diverged, not_finite
from marl_clean.storage.manifest import (
    FOLDER,
    MANIFEST,
    STATE,
    TENSORS,
    WEIGHT_KINDS,
    Damaged,
    canonical,
    make_manifest,
    paths,
    read_json,
    verify,
)

DTYPES = {
    torch.float64: "F64",
    torch.float32: "F32",
    torch.float16: "F16",
    torch.bfloat16: "BF16",
    torch.int64: "I64",
    torch.int32: "I32",
    torch.int16: "I16",
    torch.int8: "I8",
    torch.uint8: "U8",
    torch.bool: "BOOL",
}
CHANNEL = "channel."  # prefix of the names of weights that a channel has learnt
BESIDE_WEIGHTS = 64 << 20  # bytes of a file beside a network's own: a header, another channel
log = logging.getLogger(__name__)


class AllDamaged(BadInput):
    """Every checkpoint of a kind is damaged; the message says how the newest is."""


@dataclass(frozen=True)
class Checkpoint:
    """One saved state of a run: its frames, notes beside it, and the tree itself."""

    frames: int
    notes: dict[str, Any]
    tree: Any


class Checkpoints:
    """The checkpoints of one run, several kinds of them in one folder.

    Args:
        folder: where they are; made when the first is saved.
        keep: how many of a kind stay; with two, a damaged one has a predecessor.
    """

    def __init__(self, folder: Path, keep: int = 2) -> None:
        self.folder = folder
        self.keep = keep

    def save(self, kind: str, frames: int, tree: Any, notes: Mapping[str, Any]) -> None:
        """Save a tree of dicts, lists, tensors and numbers; then prune older ones of its kind.

        Raises:
            BadInput: the disk refuses, or returns something else; older ones stay.
            Diverged: something in it is NaN or infinite; nothing is written.
        """
        if bad := [*not_finite(tree), *not_finite(notes)]:
            raise Diverged(f"frame {frames}: {bad[0]} is NaN or infinite; {kind} is not saved")
        path = self.folder / f"{kind}-{frames:012d}"
        tensors: dict[str, Tensor] = {}
        encoded = encode(tree, "", tensors)
        text = canonical({"frames": frames, "kind": kind, "notes": dict(notes), "tree": encoded})
        try:
            files.make_folder(self.folder)
            files.clear_leftovers(self.folder)
            if not self._holds(path):  # a resumed run comes here again: same frames, same state
                contents = {TENSORS: _safetensors(tensors), STATE: [text]}
                files.write_folder(path, contents, MANIFEST, make_manifest)
                verify(path)
        except OSError as error:
            raise BadInput(f"{path}: cannot be saved: {error.strerror}") from error
        except Damaged as error:
            raise BadInput(f"{path}: the disk does not keep what is written: {error}") from error
        for old in paths(self.folder, kind)[self.keep :]:
            files.remove_folder(old)

    def _holds(self, path: Path) -> bool:
        """Whether there is an undamaged checkpoint at `path`; a damaged one is removed."""
        if not path.exists():
            return False
        try:
            verify(path)
        except Damaged:
            files.remove_folder(path)
            return False
        return True

    def newest(self, kind: str, largest: int | None = None) -> Checkpoint | None:
        """Return the newest undamaged checkpoint of a kind; None if there is none at all.

        A damaged one is passed over with one line in the log, and so is one whose tensors are
        longer than `largest` bytes.

        Raises:
            AllDamaged: none of them is whole.
        """
        damaged: list[str] = []
        for path in paths(self.folder, kind):
            try:
                checkpoint = _read(path, largest)
            except Damaged as error:
                damaged.append(f"{path} is damaged ({error})")
                continue
            for line in damaged:
                log.warning("%s: going back to the one before", line)
            return checkpoint
        if damaged:
            raise AllDamaged(
                f"{self.folder}: every {kind} checkpoint is damaged; start a new run ({damaged[0]})"
            )
        return None

    def forget_after(self, frames: int) -> None:
        """Remove what was saved after `frames`, which a run that resumes there saves again."""
        files.clear_leftovers(self.folder)
        for path in paths(self.folder):
            if int(path.name.rpartition("-")[2]) > frames:
                files.remove_folder(path)

    def remove(self, kind: str) -> None:
        """Remove every checkpoint of a kind, the oldest first, and what crashes have left."""
        files.clear_leftovers(self.folder)
        for path in reversed(paths(self.folder, kind)):
            files.remove_folder(path)


def load_weights(run: Path, network: nn.Module | None = None) -> Checkpoint:
    """Return a run's best weights by their names in the network, or the final ones without best.

    With the `network` that they are for, nothing is loaded that is far larger than it needs.

    Raises:
        BadInput: the run has saved none, or they are damaged.
    """
    checkpoints = Checkpoints(run / FOLDER)
    largest = None
    if network is not None:
        largest = BESIDE_WEIGHTS + sum(own.nbytes for own in network.state_dict().values())
    for kind in WEIGHT_KINDS:
        checkpoint = checkpoints.newest(kind, largest)
        if checkpoint is not None:
            return checkpoint
    raise BadInput(f"{run}: has no weights yet; train it until its first evaluation")


def fit_weights(network: nn.Module, weights: Any, source: Path) -> None:
    """Load saved weights into a network in place, all of them or none.

    Only a channel's weights may differ: those that this network lacks are ignored, and its own that
    were not saved keep their values.

    Raises:
        BadInput: names, shapes or types differ from the network's, or a weight is not finite.
    """
    own = network.state_dict()
    if isinstance(weights, dict) and all(isinstance(name, str) for name in weights):
        channel = {name: w for name, w in own.items() if name.startswith(CHANNEL)}
        rest = {name: w for name, w in weights.items() if not name.startswith(CHANNEL)}
        weights = rest | {name: weights.get(name, w) for name, w in channel.items()}
    if not isinstance(weights, dict) or weights.keys() != own.keys():
        raise BadInput(f"{source}: holds the weights of another network; same config needed")
    for name, weight in own.items():
        saved = weights[name]
        if not isinstance(saved, Tensor) or saved.dtype != weight.dtype:
            raise BadInput(f"{source}: {name} is no {weight.dtype} tensor")
        if saved.shape != weight.shape:
            raise BadInput(
                f"{source}: {name} is {list(saved.shape)}, the config needs {list(weight.shape)}"
            )
        if not saved.isfinite().all():
            raise BadInput(f"{source}: {name} holds NaN or infinity")
    network.load_state_dict(weights)


def _safetensors(tensors: Mapping[str, Tensor]) -> Iterator[bytes | memoryview]:
    """Yield a safetensors file piece by piece, without a second copy of everything.

    Format: the header's length in 8 bytes, the header as JSON, the tensors one after another.
    """
    header, offset = {}, 0
    for name, tensor in tensors.items():
        end = offset + tensor.nbytes
        kind, shape = DTYPES[tensor.dtype], list(tensor.shape)
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [offset, end]}
        offset = end
    text = canonical(header)
    text += b" " * (-len(text) % 8)
    yield len(text).to_bytes(8, "little")
    yield text
    for tensor in tensors.values():
        flat = tensor.cpu().contiguous().flatten()
        yield flat.view(torch.uint8).numpy().data


def _read(path: Path, largest: int | None) -> Checkpoint:
    try:
        if largest is not None and (path / TENSORS).stat().st_size > largest:
            raise Damaged(f"{TENSORS} is longer than the {largest:,} bytes that its config needs")
        verify(path)
        state = read_json(path / STATE)
        _check_header(path / TENSORS)
        tensors = load_file(path / TENSORS)
        tree = decode(state["tree"], tensors)
        if tensors:
            raise Damaged(f"{STATE} does not name the tensor {min(tensors)[:40]!r}")
        return Checkpoint(_frames(state["frames"]), dict(state["notes"]), tree)
    except OSError as error:
        raise Damaged(f"cannot be read: {error.strerror}") from error
    except (SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        # A valid manifest does not mean that an untrusted file is a checkpoint.
        raise Damaged(f"not a checkpoint of ours, {type(error).__name__}") from error


def _check_header(path: Path) -> None:
    try:
        read_header(path)
    except ValueError as error:
        raise Damaged(f"{path.name}: {error}") from error


def _frames(frames: Any) -> int:
    if type(frames) is not int or frames < 0:
        raise Damaged(f"{STATE} holds no number of frames")
    return frames
