"""How wide a network may be."""

from bisect import bisect_right
from collections.abc import Callable, Iterable

import torch
from omegaconf import DictConfig
from torch import nn

from marl_clean.errors import BadInput


def widest_within(budget: int, size: Callable[[int], int]) -> int:
    """Return the largest width whose `size`, which grows with it, is at most `budget`.

    Raises:
        BadInput: not even one feature fits.
    """
    if (least := size(1)) > budget:
        raise BadInput(
            f"parameter_budget={budget}: the rest of the network has {least} already; give more"
        )
    too_wide = 2
    while size(too_wide) <= budget:
        too_wide *= 2
    allowed = range(too_wide // 2, too_wide)
    return allowed[bisect_right(allowed, budget, key=size) - 1]


def as_wide_as_allowed(cfg: DictConfig, build: Callable[[DictConfig], nn.Module]) -> DictConfig:
    """Return `cfg` with the encoder's features as wide as `parameter_budget` allows.

    `build` makes the network of a config without a budget. Raises BadInput as `widest_within`.
    """

    def size(width: int) -> int:
        with torch.random.fork_rng([]):
            return count_weights(build(_of_width(cfg, width)))

    return _of_width(cfg, widest_within(cfg.parameter_budget, size))


def fewest_weights(cfg: DictConfig, parts: Callable[[DictConfig], Iterable[nn.Module]]) -> int:
    """Return the weights that `parts` of a config have, with a budget those of one feature.

    They are made on torch's meta device, where tensors have shapes and no bytes.
    """
    sized = cfg if cfg.get("parameter_budget") is None else _of_width(cfg, 1)
    with torch.device("meta"):
        return sum(weight.numel() for part in parts(sized) for weight in part.parameters())


def _of_width(cfg: DictConfig, width: int) -> DictConfig:
    """Return `cfg` with so many features of the encoder, and without a budget."""
    sized = cfg.copy()
    sized.parameter_budget = None
    sized.encoder.hidden = [*cfg.encoder.hidden[:-1], width]
    return sized


def count_weights(network: nn.Module) -> int:
    """Return the weights of encoder, scheme and head, which `parameter_budget` bounds.

    So that networks with different schemes have the same size. Weights of a channel do not count:
    the network stays the same over another channel.
    """
    named = network.named_parameters()
    return sum(w.numel() for name, w in named if not name.startswith("channel."))
