"""NaN and infinity in what a run holds, by name: what has them is not saved."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from marl_clean.errors import BadInput


class Diverged(BadInput):
    """A number of a run is NaN or infinite; the message names it, and the frame or update."""


def not_finite(tree: Any) -> list[str]:
    """Return the paths of what is NaN or infinite in a tree of dicts, lists, tensors and numbers.

    All tensors are read in one pass without a copy, and a device is waited for once for each type
    of numbers. Least and greatest of numbers with a NaN among them are NaN.
    """
    groups: dict[tuple[torch.device, torch.dtype], dict[str, Tensor]] = {}
    leaves = dict(_leaves(tree, ""))
    for path, leaf in leaves.items():
        if isinstance(leaf, Tensor) and leaf.numel():
            groups.setdefault((leaf.device, leaf.dtype), {})[path] = leaf.detach()
    numbers = {path: leaf for path, leaf in leaves.items() if isinstance(leaf, float)}
    bad = {path for path, number in numbers.items() if not math.isfinite(number)}
    for group in groups.values():
        extremes = [torch.stack(torch.aminmax(tensor)) for tensor in group.values()]
        finite = torch.stack(extremes).isfinite().all(-1).tolist()
        bad |= {path for path, is_finite in zip(group, finite, strict=True) if not is_finite}
    return [path for path in leaves if path in bad]


def _leaves(tree: Any, path: str) -> Iterator[tuple[str, Tensor | float]]:
    """The tensors and numbers with a fraction, each under its path."""
    if isinstance(tree, Tensor):
        if tree.is_floating_point():
            yield path, tree
    elif isinstance(tree, float):
        yield path, tree
    elif isinstance(tree, Mapping | TensorDictBase | list | tuple):
        pairs = enumerate(tree) if isinstance(tree, list | tuple) else tree.items()
        for key, value in pairs:
            yield from _leaves(value, f"{path}/{key}" if path else str(key))
