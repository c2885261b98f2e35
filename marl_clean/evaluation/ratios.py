"""Ratios of means over runs and houses, with intervals from resamples that all sides share.

    ratio of means        mean x / mean y
    recovered headroom    (mean s - mean x) / (mean s - mean o)

x, y, s (silent) and o (oracle) are values of the same houses, run by run, so a resample draws the
same runs and houses on all sides: what makes a house slow for everybody leaves the ratio alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from marl_clean.errors import BadInput
from marl_clean.evaluation.aggregates import mean
from marl_clean.evaluation.resampling import DRAWS, Interval, Resampling, percentiles, resamples

Means = Sequence[Float[np.ndarray, "*batch"]]


@dataclass(frozen=True)
class Recovered:
    """How much of the headroom an arm recovers.

    Attributes:
        share: 0 is the silent arm's mean, 1 the oracle's; None where the gap is not clear.
        gap: silent minus oracle, the headroom itself.
    """

    share: Interval
    gap: Interval

    @property
    def is_clear(self) -> bool:
        """Whether the oracle gains: the interval of the gap lies above 0."""
        return self.gap.ci95 is not None and self.gap.ci95[0] > 0


def ratio_of_means(
    values: Float[np.ndarray, "run house"],
    baseline: Float[np.ndarray, "other_run other_house"],
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Interval:
    """The mean of `values` divided by that of `baseline`; no value over a mean of 0.

    A side of one run is paired with every run of the other. Raises BadInput where runs or houses
    differ in number.
    """
    return _of_means(lambda sides: _quotient(sides[0], sides[1]), (values, baseline), how, draws)


def recovered_headroom(
    silent: Float[np.ndarray, "run house"],
    arm: Float[np.ndarray, "arm_run arm_house"],
    oracle: Float[np.ndarray, "oracle_run oracle_house"],
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Recovered:
    """Which share of the steps between silent and oracle an arm saves; less is better.

    Below 0 it is slower than silent, above 1 faster than the oracle. Where the interval of
    silent - oracle does not lie above 0 there is no headroom to share out, and no number: the
    quotient of two noises is none. Of the other resamples, the few whose gap is not above 0 are
    left out. A side of one run (a planner) is paired with every run of the others. Raises
    BadInput where runs or houses differ in number.
    """
    sides = (silent, arm, oracle)
    gap = _of_means(lambda means: np.asarray(means[0] - means[2]), sides, how, draws)
    whole = Recovered(Interval(None, None), gap)
    if not whole.is_clear:
        return whole

    def share(means: Means) -> Float[np.ndarray, "*batch"]:
        gaps = np.asarray(means[0] - means[2])
        return _quotient(np.asarray(means[0] - means[1]), np.where(gaps > 0, gaps, 0.0))

    return Recovered(_of_means(share, sides, how, draws), gap)


def _of_means(
    statistic: Callable[[Means], Float[np.ndarray, "*batch"]],
    sides: Sequence[Float[np.ndarray, "_run house"]],
    how: Resampling,
    draws: int,
) -> Interval:
    """A statistic of the sides' means, and its interval; a house must be known on all sides."""
    runs = max(len(side) for side in sides)
    houses = sides[0].shape[1]
    if any(side.shape[1] != houses or len(side) not in (1, runs) for side in sides):
        shapes = ", ".join(f"{len(side)} runs of {side.shape[1]} houses" for side in sides)
        raise BadInput(f"a paired ratio needs as many runs and houses on all sides, not {shapes}")
    stacked = np.stack([np.broadcast_to(side, (runs, houses)) for side in sides])
    known = np.isfinite(stacked).all(0)
    if not known.any():
        return Interval(None, None)
    stacked = np.where(known, stacked, np.nan)
    value = float(statistic([mean(side) for side in stacked]))
    if not np.isfinite(value):
        return Interval(None, None)
    drawn = [
        statistic([mean(side) for side in blocks])
        for blocks in zip(*(resamples(side, how, draws) for side in stacked), strict=True)
    ]
    low, high = percentiles(np.concatenate(drawn))
    return Interval(value, (float(low), float(high)))


def _quotient(
    over: Float[np.ndarray, "*batch"], under: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch"]:
    """NaN where `under` is 0."""
    return np.divide(over, under, out=np.full(np.shape(over), np.nan), where=np.asarray(under) != 0)
