"""How wide a network may be."""

from bisect import bisect_right
from collections.abc import Callable

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
