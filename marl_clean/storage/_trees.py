"""Trees of a checkpoint as JSON with names in place of tensors, and back."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from marl_clean.storage.manifest import STATE, Damaged

LARGEST_SIZE = 1 << 40  # of a TensorDict's batch


def encode(tree: Any, path: str, tensors: dict[str, Tensor]) -> Any:
    """Turn a tree into JSON; its tensors are added to `tensors` in place, under their paths."""

    def named(pairs: Iterable[tuple[Any, Any]]) -> list[Any]:
        return [[key, encode(value, f"{path}/{key}", tensors)] for key, value in pairs]

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


def decode(node: Any, tensors: dict[str, Tensor]) -> Any:
    """Build a tree from JSON; the tensors it names are taken out of `tensors`, each once.

    The JSON need not be trusted. Raises Damaged where it is no tree, and what TensorDict raises
    for tensors that do not fit together.
    """
    match node:
        case {"tensor": str(name), "channels_last": bool(channels_last)}:
            if name not in tensors:
                raise Damaged(f"{STATE} names the tensor {name[:40]!r} twice, or there is none")
            memory = torch.channels_last if channels_last else torch.contiguous_format
            return tensors.pop(name).clone(memory_format=memory)
        case {"tensordict": list(pairs), "batch_size": list(batch_size)}:
            held = {key: decode(value, tensors) for key, value in pairs}
            _check_tensordict(held, batch_size)
            return TensorDict(held, batch_size)
        case {"dict": list(pairs)}:
            return {key: decode(value, tensors) for key, value in pairs}
        case {"list": list(values)}:
            return [decode(value, tensors) for value in values]
        case {"tuple": list(values)}:
            return tuple(decode(value, tensors) for value in values)
        case None | bool() | int() | float() | str():
            return node
    raise Damaged(f"{STATE} is not a tree")


def _check_tensordict(held: Mapping[Any, Any], batch_size: list[Any]) -> None:
    """Raises Damaged where a TensorDict would hold anything but tensors under their names."""
    named = all(isinstance(key, str) for key in held)
    tensors = all(isinstance(value, Tensor | TensorDictBase) for value in held.values())
    sizes = all(type(size) is int and 0 <= size < LARGEST_SIZE for size in batch_size)
    if not (named and tensors and sizes):
        raise Damaged(f"{STATE} holds a TensorDict that is none")
