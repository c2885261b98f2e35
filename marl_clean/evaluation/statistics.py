"""Means with bootstrap intervals, as every table and figure of this project reports them.

A sample is a matrix [run, house]; one run is a matrix of one row. NaN stands for no value
(a ratio to a bound of 0): means leave it out, resampling keeps it. Other statistics than the mean
are in aggregates.py, with intervals from resampling.py.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, UInt
from scipy.special import stdtr  # scipy.stats has it too, and takes a second to import

from marl_clean.errors import BadInput

DRAWS = 10_000
SEED = 0
LEVEL = 95  # per cent
_BLOCK = 2_000_000  # indices held at once: bounds the memory at some tens of MB


@dataclass(frozen=True)
class Estimate:
    """A mean and its interval; both are None where no value exists."""

    mean: float | None
    ci95: tuple[float, float] | None


def estimate(values: Float[np.ndarray, "run house"], draws: int = DRAWS) -> Estimate:
    """The mean over runs of the mean over houses, with its percentile bootstrap interval."""
    if not np.isfinite(values).any():
        return Estimate(None, None)
    means = bootstrap_means(values, draws=draws)
    tail = (100 - LEVEL) / 2
    low, high = np.nanpercentile(means, [tail, 100 - tail])
    return Estimate(float(_mean_of_runs(values)), (float(low), float(high)))


def bootstrap_means(
    values: Float[np.ndarray, "run house"], seed: int = SEED, draws: int = DRAWS
) -> Float[np.ndarray, " draw"]:
    """The mean of each resample: runs with replacement, then houses within each drawn run.

    With a single run only the houses are resampled. Samples of the same shape are resampled alike.
    """
    runs, houses = values.shape
    run, times = _resamples(seed, draws, runs, houses)
    known = np.isfinite(values)
    table = np.where(known, values, 0.0).T
    if not known.all():
        table = np.concatenate([table, known.T.astype(np.float64)], axis=1)
    sums = np.empty((len(run), table.shape[1]))
    rows = max(1, _BLOCK // houses)
    for start in range(0, len(run), rows):
        block = slice(start, start + rows)
        sums[block] = times[block].astype(np.float64) @ table
    own = np.arange(len(run))
    total, count = sums[own, run], houses if known.all() else sums[own, runs + run]
    means = (total / np.maximum(count, 1)).reshape(draws, runs)
    counted = np.broadcast_to(count, total.shape).reshape(draws, runs) > 0
    number = counted.sum(1)
    return np.divide(means.sum(1), number, out=np.full(draws, np.nan), where=number > 0)


@lru_cache(maxsize=2)  # a table asks for a few dozen measures of the same runs and houses
def _resamples(
    seed: int, draws: int, runs: int, houses: int
) -> tuple[Int[np.ndarray, " row"], UInt[np.ndarray, "row house"]]:
    """Which run stands at each place of each draw, row by row, and how often each of its houses."""
    rng = np.random.default_rng(seed)
    run = rng.integers(runs, size=(draws, runs))
    times = np.empty((draws, runs, houses), np.min_scalar_type(houses))  # 6 MB for 3 x 200
    rows = max(1, _BLOCK // houses)
    for place in range(runs):
        for start in range(0, draws, rows):
            drawn = rng.integers(houses, size=(min(rows, draws - start), houses))
            drawn += houses * np.arange(len(drawn))[:, None]
            counts = np.bincount(drawn.ravel(), minlength=drawn.size)
            times[start : start + rows, place] = counts.reshape(drawn.shape)
    return run.ravel(), times.reshape(-1, houses)


def paired_difference(
    values: Float[np.ndarray, "run house"],
    baseline: Float[np.ndarray, "other_run other_house"],
    draws: int = DRAWS,
) -> Estimate:
    """The mean of `values` minus `baseline`, house by house, with its interval.

    A single run on either side (a planner) is paired with every run of the other.
    Raises BadInput where the houses differ in number, or the runs cannot be paired.
    """
    return estimate(_differences(values, baseline), draws)


def paired_p(
    values: Float[np.ndarray, "run house"],
    baseline: Float[np.ndarray, "other_run other_house"],
) -> float:
    """Two-sided p of a mean difference of 0, where runs and houses are both random samples.

        t = mean / sqrt(s_R^2 / R + s_H^2 / H),    R - 1 degrees of freedom, or H - 1 if fewer

    s_R: standard deviation of the R runs' mean differences, s_H: of the H houses'. Variance that
    both share is counted twice and the fewer degrees are taken, so that p is conservative. One run
    is not a sample of runs: then p is over houses alone, and holds for these weights only.
    Source: H. Clark, "The language-as-fixed-effect fallacy" (1973), whose min F' this t^2 is.
    The share of bootstrap means beyond 0 would not do: if three runs agree in sign, so does every
    resample.
    """
    differences = _differences(values, baseline)
    errors, degrees = [], []
    for means in sampled_means(differences):
        errors.append(float(means.var(ddof=1)) / len(means))
        degrees.append(len(means) - 1)
    mean = float(_mean_of_runs(differences)) if errors else 0.0
    if mean == 0:
        return 1.0
    error = sum(errors) ** 0.5
    return float(2 * stdtr(min(degrees), -abs(mean) / error)) if error else 0.0


def sampled_means(
    values: Float[np.ndarray, "run house"],
) -> Iterator[Float[np.ndarray, " mean"]]:
    """The mean of each run, then of each house; what there is only one of is no sample."""
    for rows in (values, values.T):
        means, known = _row_means(rows)
        if (known > 0).sum() > 1:
            yield means[known > 0]


def holm(values: Sequence[float]) -> list[float]:
    """p-values corrected for multiple comparisons: Holm's step-down (S. Holm, 1979), in order.

    p'_(k) = max over j <= k of min(1, (m - j + 1) p_(j)),    p_(1) <= ... <= p_(m)
    """
    order = sorted(range(len(values)), key=lambda index: values[index])
    corrected, highest = [0.0] * len(values), 0.0
    for place, index in enumerate(order):
        highest = max(highest, min(1.0, (len(values) - place) * values[index]))
        corrected[index] = highest
    return corrected


def _differences(
    values: Float[np.ndarray, "run house"], baseline: Float[np.ndarray, "other_run other_house"]
) -> Float[np.ndarray, "runs house"]:
    runs, houses = values.shape
    other_runs, other_houses = baseline.shape
    if houses != other_houses:
        raise BadInput(
            f"a paired difference needs the same houses, not {houses} and {other_houses}"
        )
    if runs != other_runs and 1 not in (runs, other_runs):
        raise BadInput(f"{runs} runs against {other_runs}: give as many on both sides, or one")
    return values - baseline


def as_sample(runs: Sequence[Sequence[int | float | None]]) -> Float[np.ndarray, "run house"]:
    """A matrix of the runs' values, NaN where a record holds null."""
    return np.array(
        [[np.nan if value is None else value for value in run] for run in runs], dtype=np.float64
    )


def _mean_of_runs(values: Float[np.ndarray, "run house"]) -> np.float64:
    mean, exists = _row_means(values)
    return mean.sum() / exists.sum()


def _row_means(
    values: Float[np.ndarray, "row house"],
) -> tuple[Float[np.ndarray, " row"], Float[np.ndarray, " row"]]:
    """Each row's mean without NaN (0 for a row of NaN), and 1.0 for rows that have a value."""
    known = np.isfinite(values)
    count = known.sum(axis=1)
    total = np.where(known, values, 0.0).sum(axis=1)
    return total / np.maximum(count, 1), (count > 0).astype(np.float64)
