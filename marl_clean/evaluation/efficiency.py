"""Sample-efficiency curves: a validation measure over seeds, against frames of training.

    at each frame f:  IQM (or mean) over the seeds' values at f, with a percentile interval

Seeds are resampled as whole curves. Source: Agarwal et al. (arXiv 2108.13264, section 4.1).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from marl_clean.evaluation.aggregates import iqm
from marl_clean.evaluation.resampling import (
    DRAWS,
    Resampling,
    Statistic,
    percentiles,
    resamples,
)

Series = Sequence[tuple[float, float]]  # (frames, value), of a run's metrics.csv


@dataclass(frozen=True)
class Curve:
    """A measure over training.

    Attributes:
        frames: env steps of all worlds, ascending: every frame at which a seed has a value.
        value: the statistic over the seeds that have a value there.
        low, high: ends of its 95 % interval; NaN with a single seed, which has none.
        seeds: how many seeds have a value there: a seed that stopped early ends early.
    """

    frames: Float[np.ndarray, " frame"]
    value: Float[np.ndarray, " frame"]
    low: Float[np.ndarray, " frame"]
    high: Float[np.ndarray, " frame"]
    seeds: Int[np.ndarray, " frame"]


def sample_efficiency(
    runs: Sequence[Series], statistic: Statistic = iqm, draws: int = DRAWS
) -> Curve | None:
    """The curve of several seeds; None where none has a value.

    Of two values at one frame (a resumed run logs it again) the later counts.
    """
    frames = np.array(sorted({frame for run in runs for frame, _ in run}), dtype=np.float64)
    if not frames.size:
        return None
    values = np.full((len(runs), len(frames)), np.nan)
    for row, run in zip(values, runs, strict=True):
        for frame, value in run:
            row[np.searchsorted(frames, frame)] = value
    low = high = np.full(len(frames), np.nan)
    if len(runs) > 1:
        whole = np.arange(len(runs))[:, None]  # whole curves are drawn
        drawn = [
            _over_seeds(values[block[..., 0]], statistic)
            for block in resamples(whole, Resampling.RUNS_AND_HOUSES, draws)
        ]
        ends = np.concatenate(drawn)
        known = ~np.isnan(ends).all(0)
        low, high = low.copy(), high.copy()
        low[known], high[known] = percentiles(ends[:, known])
    seeds = (~np.isnan(values)).sum(0)
    single = seeds < 2
    low, high = np.where(single, np.nan, low), np.where(single, np.nan, high)
    return Curve(frames, _over_seeds(values, statistic), low, high, seeds)


def _over_seeds(
    values: Float[np.ndarray, "*draw run frame"], statistic: Statistic
) -> Float[np.ndarray, "*draw frame"]:
    """The statistic of each frame's values, as a matrix of runs by one house."""
    return statistic(np.swapaxes(values, -1, -2)[..., None])
