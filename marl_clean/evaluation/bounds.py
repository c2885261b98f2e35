"""Lower bounds on the times at which a house can be clean.

F free cells, n0 distinct start cells, n robots, each of which cleans at most one cell a step:
T_q >= ceil((need(q) - n0) / n), and T_100 >= the longest of the shortest walks to a cell.
Integers throughout.
"""

from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world import searches

Count = TypeVar("Count", int, np.ndarray, Tensor)  # one house, or a vector of houses


def ceil_div(numerator: Count, denominator: int) -> Count:
    """The quotient rounded up, by integers alone."""
    return -(-numerator // denominator)


def need(percent: int, num_free: Count) -> Count:
    """The number of cells that are `percent` of a house: ceil(percent * F / 100)."""
    return ceil_div(percent * num_free, 100)


def bound_cells(
    cells: Int[np.ndarray, " house"], num_starts: Int[np.ndarray, " house"], n_agents: int
) -> Int[np.ndarray, " house"]:
    """Steps that n robots need for this number of cells, the starts being clean at step 0."""
    return np.maximum(ceil_div(cells - num_starts, n_agents), 0)


def bound_percent(
    percent: int,
    num_free: Int[np.ndarray, " house"],
    num_starts: Int[np.ndarray, " house"],
    n_agents: int,
) -> Int[np.ndarray, " house"]:
    """The least T_q: ceil((need(q) - n0) / n)."""
    return bound_cells(need(percent, num_free), num_starts, n_agents)


def bound_100(
    free: Bool[np.ndarray, "house row col"], starts: Int[np.ndarray, "house robot 2"]
) -> Int[np.ndarray, " house"]:
    """The least T_100: the larger of a robot's share of cells and the walk to the farthest cell."""
    n_agents = starts.shape[1]
    work = bound_percent(100, free.sum(axis=(1, 2)), count_starts(starts), n_agents)
    return np.maximum(work, walking_distance(free, starts).max(axis=(1, 2)))


def bound_certify(
    free: Bool[np.ndarray, "house row col"], starts: Int[np.ndarray, "house robot 2"]
) -> Int[np.ndarray, " house"]:
    """The least T_certify for blind robots that know nothing: ceil((F - n0 + B) / n).

    Every one of the B blocked cells beside a free one costs a bump. The cells just outside
    the house are blocked too.
    """
    cells = free.sum(axis=(1, 2)) + count_border(free)
    return bound_cells(cells, count_starts(starts), starts.shape[1])


def count_starts(starts: Int[np.ndarray, "house robot 2"]) -> Int[np.ndarray, " house"]:
    """Distinct start cells of each house."""
    return np.array([len(np.unique(house, axis=0)) for house in starts])


def count_border(free: Bool[np.ndarray, "house row col"]) -> Int[np.ndarray, " house"]:
    """The number of blocked cells with a free cell above, right, below or left of them."""
    ringed = np.pad(free, ((0, 0), (1, 1), (1, 1)))
    return (_spread(ringed) & ~ringed).sum(axis=(1, 2))


def walking_distance(
    free: Bool[np.ndarray, "house row col"], starts: Int[np.ndarray, "house robot 2"]
) -> Int[np.ndarray, "house row col"]:
    """Steps from the nearest start to each cell; -1 where no robot can reach it."""
    sources = np.zeros_like(free)
    sources[np.arange(len(free))[:, None], starts[..., 0], starts[..., 1]] = True
    steps = searches.distances(free, sources)
    return np.where(steps == searches.UNREACHABLE, -1, steps).astype(np.int64)


def _spread(cells: Bool[np.ndarray, "house row col"]) -> Bool[np.ndarray, "house row col"]:
    """The cells and their four neighbours."""
    spread = cells.copy()
    spread[:, 1:] |= cells[:, :-1]
    spread[:, :-1] |= cells[:, 1:]
    spread[:, :, 1:] |= cells[:, :, :-1]
    spread[:, :, :-1] |= cells[:, :, 1:]
    return spread
