"""Performance profiles: the whole distribution of runs and houses as a curve, with a band.

    F(tau) = share of pairs (run, house) with a score above tau

Source: Agarwal et al. (arXiv 2108.13264, section 4.2), whose score distribution this is. Where two
profiles do not cross, the upper policy is better by every quantile. Bands are pointwise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from marl_clean.evaluation.resampling import DRAWS, Resampling, percentiles, resamples

POINTS = 101  # of a grid, both ends included


@dataclass(frozen=True)
class Profile:
    """Shares from 0 to 1 at each place of a grid, with the ends of their 95 % intervals.

    Attributes:
        grid: thresholds of the score, or steps.
        share: of all pairs of run and house that have a value.
        low, high: pointwise ends.
    """

    grid: Float[np.ndarray, " place"]
    share: Float[np.ndarray, " place"]
    low: Float[np.ndarray, " place"]
    high: Float[np.ndarray, " place"]


def profile(
    scores: Float[np.ndarray, "run house"],
    taus: Float[np.ndarray, " tau"],
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Profile | None:
    """The share of pairs with a score above each tau; None where no pair has a score.

    `taus` ascend. NaN stands for no score, and is left out.
    """
    if np.isnan(scores).all():
        return None
    passed = _passed(scores, taus)
    drawn = [_shares(block, len(taus)) for block in resamples(passed, how, draws)]
    low, high = percentiles(np.concatenate(drawn))
    return Profile(taus, _shares(passed[None], len(taus))[0], low, high)


def finished_by(
    times: Float[np.ndarray, "run house"],
    steps: Float[np.ndarray, " step"],
    how: Resampling = Resampling.RUNS_AND_HOUSES,
    draws: int = DRAWS,
) -> Profile | None:
    """The share of houses finished by each step: of pairs whose time is at most that step.

    `times` are infinite where a house was not finished, so that the curve ends at the share of
    houses finished. `steps` ascend. It is 1 minus the profile of the times.
    """
    later = profile(times, steps, how, draws)
    if later is None:
        return None
    return Profile(steps, 1 - later.share, 1 - later.high, 1 - later.low)


def score_grid() -> Float[np.ndarray, " tau"]:
    """Thresholds from 0 to 1, both included."""
    return np.linspace(0, 1, POINTS)


def step_grid(most: int) -> Float[np.ndarray, " step"]:
    """Whole steps from 0 to `most`, both included, at most `POINTS` of them."""
    return np.unique(np.linspace(0, most, POINTS).round())


def _passed(
    scores: Float[np.ndarray, "run house"], taus: Float[np.ndarray, " tau"]
) -> Int[np.ndarray, "run house"]:
    """How many taus each score is above; -1 for no score."""
    return np.where(np.isnan(scores), -1, np.searchsorted(taus, scores, side="left"))


def _shares(
    passed: Int[np.ndarray, "draw run house"], number: int
) -> Float[np.ndarray, "draw {number}"]:
    """Of each draw the share of scores above each of the `number` taus, from what they pass."""
    draws, bins = len(passed), number + 2  # the first bin is of those without a score
    place = passed.reshape(draws, -1) + 1 + bins * np.arange(draws)[:, None]
    counts = np.bincount(place.ravel(), minlength=draws * bins).reshape(draws, bins)[:, 1:]
    at_least = counts[:, ::-1].cumsum(1)[:, ::-1]  # [:, k]: scores above at least k taus
    total = at_least[:, :1]
    shares = np.full((draws, number), np.nan)
    return np.divide(at_least[:, 1:], total, out=shares, where=total > 0)
