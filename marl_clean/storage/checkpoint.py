"""Checkpoints: tensors as safetensors, the rest as JSON, each proven by a manifest of sha256.

A checkpoint is a folder `<kind>-<frames>` of three files:

    tensors.safetensors  every tensor, under its path in the tree
    state.json           kind, frames, notes, and the tree with names in place of tensors
    manifest.json        length and sha256 of the other two

It is written under a fresh name, read again, and only then are older ones pruned. Reading takes
the newest whose manifest holds; nothing is ever unpickled.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from marl_clean.errors import BadInput
from marl_clean.storage import files
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
log = logging.getLogger(__name__)


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
        encoded = _encode(tree, "", tensors)
        text = canonical({"frames": frames, "kind": kind, "notes": dict(notes), "tree": encoded})
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            files.clear_leftovers(self.folder)
            if self._holds(path):  # a resumed run comes here again: same frames, same state
                return
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

    def newest(self, kind: str) -> Checkpoint | None:
        """Return the newest undamaged checkpoint of a kind; None if there is none at all.

        A damaged one is passed over with one line in the log.

        Raises:
            BadInput: every one of them is damaged.
        """
        candidates = paths(self.folder, kind)
        for path in candidates:
            try:
                return _read(path)
            except Damaged as error:
                log.warning("%s is damaged (%s): going back to the one before", path, error)
        if candidates:
            raise BadInput(f"{self.folder}: every {kind} checkpoint is damaged; start a new run")
        return None

    def forget_after(self, frames: int) -> None:
        """Remove what was saved after `frames`: a run that resumes there saves it again."""
        for path in paths(self.folder):
            if int(path.name.rpartition("-")[2]) > frames:
                files.remove_folder(path)

    def remove(self, kind: str) -> None:
        """Remove every checkpoint of a kind, the oldest first."""
        for path in reversed(paths(self.folder, kind)):
            files.remove_folder(path)


def load_weights(run: Path) -> Checkpoint:
    """Return a run's best weights by their names in the network, or the final ones without best.

    Raises:
        BadInput: the run has saved none, or they are damaged.
    """
    checkpoints = Checkpoints(run / FOLDER)
    for kind in WEIGHT_KINDS:
        checkpoint = checkpoints.newest(kind)
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
    if isinstance(weights, dict):
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


def _encode(tree: Any, path: str, tensors: dict[str, Tensor]) -> Any:
    """Turn a tree into JSON; its tensors are added to `tensors` in place, under their paths."""

    def named(pairs: Iterable[tuple[Any, Any]]) -> list[Any]:
        return [[key, _encode(value, f"{path}/{key}", tensors)] for key, value in pairs]

    if isinstance(tree, Tensor):
        name = path.removeprefix("/")
        tensors[name] = tree.detach()
        channels_last = tree.ndim == 4 and not tree.is_contiguous()
        return {"tensor": name, "channels_last": channels_last}
    if isinstance(tree, TensorDictBase):
        return {"tensordict": named(tree.items()), "batch_size": list(tree.batch_size)}
    if isinstance(tree, Mapping):
        return {"dict": named(tree.items())}
    if isinstance(tree, list | tuple):
        kind = "list" if isinstance(tree, list) else "tuple"
        return {kind: [value for _, value in named(enumerate(tree))]}
    if tree is None or isinstance(tree, bool | int | float | str):
        return tree
    raise TypeError(f"{path}: a {type(tree).__name__} cannot be saved")


def _decode(node: Any, tensors: Mapping[str, Tensor]) -> Any:
    match node:
        case {"tensor": str(name), "channels_last": bool(channels_last)}:
            memory = torch.channels_last if channels_last else torch.contiguous_format
            return tensors[name].clone(memory_format=memory)
        case {"tensordict": list(pairs), "batch_size": list(batch_size)}:
            return TensorDict({key: _decode(value, tensors) for key, value in pairs}, batch_size)
        case {"dict": list(pairs)}:
            return {key: _decode(value, tensors) for key, value in pairs}
        case {"list": list(values)}:
            return [_decode(value, tensors) for value in values]
        case {"tuple": list(values)}:
            return tuple(_decode(value, tensors) for value in values)
        case None | bool() | int() | float() | str():
            return node
    raise Damaged(f"{STATE} is not a tree")


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


def _read(path: Path) -> Checkpoint:
    verify(path)
    state = read_json(path / STATE)
    try:
        tensors = load_file(path / TENSORS)
        tree = _decode(state["tree"], tensors)
        return Checkpoint(int(state["frames"]), dict(state["notes"]), tree)
    except (SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        # A valid manifest does not mean that an untrusted file is a checkpoint.
        raise Damaged(f"not a checkpoint of ours, {type(error).__name__}") from error
