"""The probability that one policy beats another in a house, averaged over houses.

    P(X > Y) = mean over houses h of  U_h / (N M),    U_h = sum over runs i, j of S(x_ih, y_jh)
    S(x, y) = 1 if x > y,  1/2 if x = y,  0 if x < y

U_h is the statistic of the Mann-Whitney U test with N runs of X and M of Y.
Source: Agarwal et al. (arXiv 2108.13264, section 4.4). 1/2: neither is better. It says how
often, not by how much: that is what the paired difference says.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from marl_clean.errors import BadInput
from marl_clean.evaluation.aggregates import known_mean
from marl_clean.evaluation.resampling import (
    DRAWS,
    SEED,
    Interval,
    Resampling,
    blocks,
    draw_houses,
    draw_runs,
    percentiles,
)


def probability_of_improvement(
    better: Float[np.ndarray, "run house"],
    baseline: Float[np.ndarray, "other_run other_house"],
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Interval:
    """P(better > baseline) with its interval; more is better, so times enter as -T.

    The runs of both sides are resampled independently, houses for both together. Infinite values
    are valid (a house not finished: -T is minus infinity); a house where a side has no value (NaN)
    is left out. Raises BadInput where the houses differ in number.
    """
    if better.shape[1] != baseline.shape[1]:
        raise BadInput(
            "a probability of improvement needs the same houses, not"
            f" {better.shape[1]} and {baseline.shape[1]}"
        )
    first, second = better[:, None], baseline[None]
    known = ~(np.isnan(first) | np.isnan(second))
    if not known.any():
        return Interval(None, None)
    points = np.where(known, (first > second) + 0.5 * (first == second), 0.0)  # S
    rng = np.random.default_rng(SEED)
    runs, others, houses = points.shape
    drawn = []
    for count in blocks(draws, others * houses):
        run = _counts(draw_runs(how, rng, (count, runs, houses)), runs)
        other = _counts(draw_runs(how, rng, (count, others, houses)), others)
        house = np.broadcast_to(draw_houses(how, rng, count, houses)[:, 0], (count, houses))
        chance = _of_houses(points, known, run, other)
        drawn.append(known_mean(np.take_along_axis(chance, house, axis=1)))
    low, high = percentiles(np.concatenate(drawn))
    chance = _of_houses(points, known, np.ones((1, runs, 1)), np.ones((1, others, 1)))
    return Interval(float(known_mean(chance)[0]), (float(low), float(high)))


def _of_houses(
    points: Float[np.ndarray, "run other_run house"],
    known: Bool[np.ndarray, "run other_run house"],
    run: Float[np.ndarray, "draw run house_or_1"],
    other: Float[np.ndarray, "draw other_run house_or_1"],
) -> Float[np.ndarray, "draw house"]:
    """U / (N M) of each house, of runs drawn so many times; NaN where no pair is known."""
    total, pairs = (
        (other * _weighed(run, table)).sum(1) for table in (points, known.astype(np.float64))
    )
    return np.divide(total, pairs, out=np.full(total.shape, np.nan), where=pairs > 0)


def _weighed(
    times: Float[np.ndarray, "draw run house_or_1"],
    table: Float[np.ndarray, "run other_run house"],
) -> Float[np.ndarray, "draw other_run house"]:
    """The sum over runs, each taken so many times: in all houses alike (faster), or in each."""
    if times.shape[-1] == 1:
        return np.tensordot(times[..., 0], table, axes=1)
    return np.einsum("dxh,xyh->dyh", times, table)


def _counts(
    drawn: Int[np.ndarray, "draw run house_or_1"], runs: int
) -> Float[np.ndarray, "draw run house_or_1"]:
    """How often each run was drawn."""
    return (drawn[:, :, None] == np.arange(runs)[:, None]).sum(1).astype(np.float64)
