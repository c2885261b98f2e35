"""Profiles against counting by hand, and the two readings of one curve."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from marl_clean.evaluation.profiles import finished_by, profile, score_grid, step_grid
from marl_clean.evaluation.resampling import Resampling
from tests.evaluation.test_aggregates import plain_resamples, some_values


def plain_profile(values: list[list[float]], taus: list[float]) -> list[float]:
    pairs = [value for run in values for value in run if value == value]
    return [sum(value > tau for value in pairs) / len(pairs) for tau in taus]


@pytest.mark.parametrize("how", Resampling)
@pytest.mark.parametrize(("runs", "missing"), [(1, 0.0), (4, 0.0), (4, 0.2)])
def test_a_profile_and_its_band_are_those_of_a_plain_loop(
    how: Resampling, runs: int, missing: float
) -> None:
    values, taus = some_values(runs, 9, missing), np.array([0.0, 0.5, 0.8, 0.81, 1.0])
    values[0, 0] = 0.8  # a score equal to tau is not above it
    result = profile(values, taus, how, draws=40)
    assert result is not None
    drawn = [
        plain_profile(matrix, taus.tolist()) for matrix in plain_resamples(values.tolist(), how, 40)
    ]
    assert result.share == pytest.approx(plain_profile(values.tolist(), taus.tolist()))
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    assert result.low == pytest.approx(low) and result.high == pytest.approx(high)


def test_finished_by_counts_the_step_itself_and_never_the_unfinished() -> None:
    times = np.array([[10.0, np.inf, 30.0, np.inf]])
    result = finished_by(times, np.array([0.0, 9.0, 10.0, 29.0, 30.0, 1e6]))
    assert result is not None
    assert result.share == pytest.approx([0, 0, 0.25, 0.25, 0.5, 0.5])


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.sampled_from([0.0, 3.0, 7.0, np.inf]), min_size=1, max_size=12))
def test_a_curve_of_times_rises_and_a_profile_of_scores_falls(times: list[float]) -> None:
    values: Any = np.array([times])
    rising = finished_by(values, step_grid(10), draws=20)
    falling = profile(np.where(np.isinf(values), 0.0, values / 10), score_grid(), draws=20)
    assert rising is not None and falling is not None
    assert (np.diff(rising.share) >= 0).all() and (np.diff(falling.share) <= 0).all()
    for curve in (rising, falling):
        assert (curve.low <= curve.high).all()
        assert curve.low.min() >= -1e-12 and curve.high.max() <= 1 + 1e-12
    assert rising.share[-1] == pytest.approx(np.isfinite(values).mean())


def test_no_score_has_no_profile() -> None:
    assert profile(np.full((2, 3), np.nan), score_grid()) is None
    assert finished_by(np.full((2, 3), np.nan), step_grid(5)) is None


def test_grids_hold_both_ends() -> None:
    assert step_grid(7).tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert (step_grid(1_000)[[0, -1]] == [0, 1_000]).all() and len(step_grid(1_000)) == 101
    assert (score_grid()[[0, -1]] == [0, 1]).all()
