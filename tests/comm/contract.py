"""The levels of conf/comm and variants of them, to hold against the contract of schemes."""

from typing import Any

from marl_clean.comm.base import Comm
from marl_clean.config.levels import read_level, rooms
from marl_clean.testing._graphs import FEATURES, draw, line, within
from marl_clean.testing._levels import Maker, maker
from marl_clean.testing.comm import make_scheme

__all__ = ["DILUTED", "FEATURES", "LEVELS", "TALKING", "VARIANTS", "draw", "line", "make", "within"]

LEVELS: list[tuple[str, dict[str, Any]]] = [(level, {}) for level in rooms()["comm"]]
TALKING = [level for level, _ in LEVELS if "places" in read_level("comm", level)]
ALL: list[tuple[str, dict[str, Any]]] = [
    *LEVELS,
    ("plan", {"combine": "sum"}),
    ("plan", {"max_neighbours": 1}),
    ("zeroed", {"combine": "sum"}),
    ("full_state", {"combine": "sum"}),
    ("full_state", {"detach": True}),
    ("commnet", {"rounds": 1}),
    ("commnet", {"rounds": 3, "detach": True}),
    ("commnet", {"divisor": "others"}),
    ("commnet", {"divisor": "others", "rounds": 1}),
    ("tarmac", {"rounds": 3}),
    ("tarmac", {"rounds": 2, "self_included": True}),
    ("tarmac", {"self_included": True, "detach": True}),
    ("ic3net", {"rounds": 2, "detach": True}),
    ("dial", {"combine": "sum"}),
    ("dgn", {"rounds": 1, "heads": 1}),
    ("dgn", {"detach": True}),
    ("magic", {"detach": True}),
    ("dcc", {"detach": True}),
    ("masia", {"detach": True}),
    ("expocomm", {"peers": "one"}),
    ("expocomm", {"detach": True}),
    *((level, {"places": True, "join": "residual"}) for level in TALKING),
    ("plan", {"combine": "sum", "places": True, "join": "gated"}),
    ("tarmac", {"rounds": 2, "self_included": True, "places": True}),
]


def maker_of(level: str, **changes: Any) -> Maker:
    return maker("comm", level, changes)


def make(level: str, **changes: Any) -> Comm:
    return make_scheme(maker_of(level, **changes))


VARIANTS = [variant for variant in ALL if not make(variant[0], **variant[1]).dilutes]
DILUTED = [variant for variant in ALL if variant not in VARIANTS]
"""Whose result depends on how many robots there are, by definition."""
