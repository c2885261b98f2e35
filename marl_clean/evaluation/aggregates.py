"""One number for many runs and houses: mean, median, interquartile mean, optimality gap.

The definitions are those of Agarwal et al. (arXiv 2108.13264, section 4.3) and rliable, with a
house for a task. Each takes any batch of matrices [run, house], and leaves out NaN, which is no
value; a matrix without any value gives NaN.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int

from marl_clean.evaluation.resampling import DRAWS, Interval, Resampling, Statistic, interval

GAMMA = 1.0  # the score of which the optimality gap is the shortfall
TRIMMED = 0.25  # of the values, at each end


def mean(values: Float[np.ndarray, "*batch run house"]) -> Float[np.ndarray, "*batch"]:
    """The mean over runs of the mean over houses."""
    return known_mean(known_mean(values))


def median(values: Float[np.ndarray, "*batch run house"]) -> Float[np.ndarray, "*batch"]:
    """The median over houses of the mean over runs."""
    of_houses = known_mean(np.swapaxes(values, -1, -2))
    ordered, count = _ordered(of_houses)
    lower, upper = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, ordered.shape[-1] - 1)
    both = np.take_along_axis(ordered, np.stack([lower, upper], axis=-1), axis=-1)
    return known_mean(both)  # of no value both are NaN


def iqm(values: Float[np.ndarray, "*batch run house"]) -> Float[np.ndarray, "*batch"]:
    """The interquartile mean: of all N values, runs and houses pooled, the middle half's mean.

        IQM = mean of x_(k+1) ... x_(N-k),    k = floor(N / 4),    x_(1) <= ... <= x_(N)

    Less noisy than the median, and not ruled by a few houses not finished, as the mean is.
    """
    ordered, count = _ordered(values.reshape(*values.shape[:-2], -1))
    size = ordered.shape[-1]
    cut = (TRIMMED * count).astype(np.int64)
    if (count == size).all():  # the same places everywhere: faster
        same = int(TRIMMED * size)
        return np.asarray(ordered[..., same : size - same].mean(-1))
    place = np.arange(size)
    kept = (place >= cut[..., None]) & (place < (count - cut)[..., None])
    total = np.where(kept, ordered, 0.0).sum(-1)
    return np.divide(total, count - 2 * cut, out=np.full(total.shape, np.nan), where=count > 0)


def optimality_gap(
    scores: Float[np.ndarray, "*batch run house"],
) -> Float[np.ndarray, "*batch"]:
    """By how much scores fall short of 1, better ones counted as 1:  1 - mean of min(score, 1)."""
    return np.asarray(GAMMA - mean(np.minimum(scores, GAMMA)))


STATISTICS: Mapping[str, Statistic] = MappingProxyType(
    {"mean": mean, "median": median, "iqm": iqm, "optimality_gap": optimality_gap}
)


def aggregates(
    values: Float[np.ndarray, "run house"],
    scores: bool = False,
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> dict[str, Interval]:
    """Each statistic with its interval; the optimality gap only of `scores`, whose best is 1."""
    return {
        name: interval(values, statistic, how, draws)
        for name, statistic in STATISTICS.items()
        if scores or statistic is not optimality_gap
    }


def known_mean(values: Float[np.ndarray, "*batch value"]) -> Float[np.ndarray, "*batch"]:
    """The mean along the last axis without NaN; NaN where there is nothing else."""
    known = ~np.isnan(values)
    count = known.sum(-1)
    total = np.where(known, values, 0.0).sum(-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _ordered(
    values: Float[np.ndarray, "*batch value"],
) -> tuple[Float[np.ndarray, "*batch value"], Int[np.ndarray, "*batch"]]:
    """The values in order, NaN last, and the number of the others."""
    return np.sort(values, axis=-1), np.asarray((~np.isnan(values)).sum(-1))
