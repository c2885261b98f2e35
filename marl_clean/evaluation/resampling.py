"""Bootstrap resamples of a matrix [run, house], and percentile intervals from them.

A run is a training with a seed of its own, measured in every house of a set. Two ways to draw:

    stratified        value*[r, h] = value[i_rh, h],    each i_rh drawn on its own
    runs and houses   value*[r, h] = value[i_r, j_h],   runs drawn whole, houses drawn whole

Stratified is what Agarwal et al. (arXiv 2108.13264) and rliable do: runs are drawn within each task
independently. That is right where each pair of run and task is a training of its own, as in Atari.
So tasks here are sets of houses whose policies were trained apart, never the houses of a set: those
share one policy, a weak one is weak in all of them, and drawing them apart would hide it. (In a
simulation of docs/statistics.md its 95 % intervals hold the mean in half of the trials.)

Runs and houses is the default: for a set of houses, with runs and houses both samples of what could
have been drawn (A. Owen, "The pigeonhole bootstrap", 2007). A resample is again a matrix of runs by
houses, so every statistic of one is defined for it. With one run it resamples houses alone: the
interval is of these weights only.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, Shaped

DRAWS = 2_000  # as many as rliable's profiles take; the two-level mean takes more (statistics.py)
SEED = 0
LEVEL = 95  # per cent
_BLOCK = 2_000_000  # values held at once: bounds the memory at some tens of MB


class Resampling(Enum):
    """What is drawn with replacement; see this module."""

    STRATIFIED = "stratified"
    RUNS_AND_HOUSES = "runs_and_houses"


@dataclass(frozen=True)
class Interval:
    """A statistic and its 95 % percentile interval; both are None where it has no value."""

    value: float | None
    ci95: tuple[float, float] | None


Statistic = Callable[[Float[np.ndarray, "*batch run house"]], Float[np.ndarray, "*batch"]]


def interval(
    values: Float[np.ndarray, "run house"],
    statistic: Statistic,
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Interval:
    """`statistic` of `values`, between the 2.5 % and the 97.5 % quantile of its resamples.

    NaN stands for no value. The same values give the same interval.
    """
    if not np.isfinite(values).any():
        return Interval(None, None)
    drawn = np.concatenate([statistic(block) for block in resamples(values, how, draws)])
    low, high = percentiles(drawn)
    return Interval(float(statistic(values)), (float(low), float(high)))


def percentiles(
    drawn: Float[np.ndarray, "*draw_rest"],
) -> tuple[Float[np.ndarray, "*others"], Float[np.ndarray, "*others"]]:
    """The ends of the 95 % interval over the first axis, draws without a value (NaN) left out."""
    tail = (100 - LEVEL) / 2
    # nanpercentile goes column by column; where nothing is missing, the other gives the same.
    percentile = np.nanpercentile if np.isnan(drawn).any() else np.percentile
    low, high = np.asarray(percentile(drawn, [tail, 100 - tail], axis=0))
    return np.asarray(low), np.asarray(high)


def resamples(
    values: Shaped[np.ndarray, "run house"], how: Resampling, draws: int = DRAWS
) -> Iterator[Shaped[np.ndarray, "draw run house"]]:
    """`draws` resamples of the matrix, in blocks that bound the memory.

    Matrices of the same shape are resampled alike.
    """
    runs, houses = values.shape
    few = draws * values.size <= _BLOCK
    drawn = _drawn_once(how, runs, houses, draws) if few else _drawn(how, runs, houses, draws)
    for places in drawn:
        yield values.take(places)


@lru_cache(maxsize=4)  # a table asks for a few dozen intervals of the same runs and houses
def _drawn_once(
    how: Resampling, runs: int, houses: int, draws: int
) -> list[Int[np.ndarray, "draw run house"]]:
    return list(_drawn(how, runs, houses, draws))


def _drawn(
    how: Resampling, runs: int, houses: int, draws: int
) -> Iterator[Int[np.ndarray, "draw run house"]]:
    """Which value stands at each place of each draw, values counted row by row."""
    rng = np.random.default_rng(SEED)
    for count in blocks(draws, runs * houses):
        run = draw_runs(how, rng, (count, runs, houses))
        yield houses * run + draw_houses(how, rng, count, houses)


def blocks(draws: int, size: int) -> Iterator[int]:
    """Numbers of draws that sum to `draws`, with `size` values each, in bounded memory."""
    most = max(1, _BLOCK // size)
    for start in range(0, draws, most):
        yield min(most, draws - start)


def draw_runs(
    how: Resampling, rng: np.random.Generator, shape: tuple[int, int, int]
) -> Int[np.ndarray, "draw run house_or_1"]:
    """Which run stands at each place of [draw, run, house]: one a house, or one for them all."""
    draws, runs, houses = shape
    drawn_apart = houses if how is Resampling.STRATIFIED else 1
    return rng.integers(runs, size=(draws, runs, drawn_apart))


def draw_houses(
    how: Resampling, rng: np.random.Generator, draws: int, houses: int
) -> Int[np.ndarray, "draw_or_1 1 house"]:
    """Which house stands at each place: itself, or one of all."""
    if how is Resampling.STRATIFIED:
        return np.arange(houses)[None, None]
    return rng.integers(houses, size=(draws, 1, houses))
