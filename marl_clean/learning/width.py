"""How wide a network may be."""

from bisect import bisect_right
from collections.abc import Callable

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


def count_weights(network: nn.Module) -> int:
    """Return the weights of encoder, scheme and head, which `parameter_budget` bounds.

    So that networks with different schemes have the same size. Weights of a channel do not count:
    the network stays the same over another channel.
    """
    named = network.named_parameters()
    return sum(w.numel() for name, w in named if not name.startswith("channel."))
