"""Aggregates and their intervals against plain loops that draw in the same order."""

import statistics as plain
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.stats import trim_mean

from marl_clean.evaluation import resampling
from marl_clean.evaluation.aggregates import (
    STATISTICS,
    aggregates,
    iqm,
    mean,
    median,
    optimality_gap,
)
from marl_clean.evaluation.resampling import SEED, Resampling, interval

Matrix = list[list[float]]


def known(values: list[float]) -> list[float]:
    return [value for value in values if value == value]


def average(values: list[float]) -> float:
    kept = known(values)
    return sum(kept) / len(kept) if kept else float("nan")


def plain_mean(values: Matrix) -> float:
    return average([average(run) for run in values])


def plain_median(values: Matrix) -> float:
    houses = known([average(list(house)) for house in zip(*values, strict=True)])
    return plain.median(houses) if houses else float("nan")


def plain_iqm(values: Matrix) -> float:
    pooled = sorted(known([value for run in values for value in run]))
    cut = len(pooled) // 4
    return average(pooled[cut : len(pooled) - cut])


def plain_gap(values: Matrix) -> float:
    return 1 - plain_mean(
        [[value if value != value or value < 1 else 1 for value in run] for run in values]
    )


PLAIN = {
    "mean": plain_mean,
    "median": plain_median,
    "iqm": plain_iqm,
    "optimality_gap": plain_gap,
}


def plain_resamples(values: Matrix, how: Resampling, draws: int) -> list[Matrix]:
    """Each resample, drawn index by index."""
    rng = np.random.default_rng(SEED)
    runs, houses = len(values), len(values[0])
    if how is Resampling.STRATIFIED:
        return [
            [[values[rng.integers(runs)][house] for house in range(houses)] for _ in range(runs)]
            for _ in range(draws)
        ]
    drawn_runs = [[rng.integers(runs) for _ in range(runs)] for _ in range(draws)]
    drawn_houses = [[rng.integers(houses) for _ in range(houses)] for _ in range(draws)]
    return [
        [[values[run][house] for house in drawn_houses[draw]] for run in drawn_runs[draw]]
        for draw in range(draws)
    ]


def some_values(runs: int, houses: int, missing: float) -> Any:
    rng = np.random.default_rng(runs + houses)
    values = rng.normal(0.8, 0.4, size=(runs, houses))
    values[rng.random(values.shape) < missing] = np.nan
    return values


@pytest.mark.parametrize("name", STATISTICS)
@pytest.mark.parametrize("how", Resampling)
@pytest.mark.parametrize(("runs", "houses", "missing"), [(1, 7, 0.0), (3, 8, 0.3), (4, 1, 0.0)])
def test_a_statistic_and_its_interval_are_those_of_a_plain_loop(
    name: str, how: Resampling, runs: int, houses: int, missing: float
) -> None:
    values = some_values(runs, houses, missing)
    result = interval(values, STATISTICS[name], how, draws=40)
    drawn = known([PLAIN[name](matrix) for matrix in plain_resamples(values.tolist(), how, 40)])
    assert result.value == pytest.approx(PLAIN[name](values.tolist()))
    assert result.ci95 == pytest.approx(np.percentile(drawn, [2.5, 97.5]))


def test_blocks_change_nothing_but_the_order_of_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    values = some_values(3, 20, 0.0)
    whole = interval(values, iqm)
    monkeypatch.setattr(resampling, "_BLOCK", 7 * values.size)  # the last block is ragged
    assert sum(resampling.blocks(2_000, values.size)) == 2_000
    assert interval(values, iqm).ci95 == pytest.approx(whole.ci95, abs=0.03)


def test_the_middle_half_by_hand_and_by_scipy() -> None:
    assert iqm(np.array([[0.0, 1.0, 2.0, 100.0], [1.0, 2.0, 3.0, -50.0]])) == 1.5
    assert iqm(np.array([[np.nan, 4.0]])) == 4.0
    values = some_values(5, 9, 0.0)
    assert iqm(values) == pytest.approx(trim_mean(values, 0.25, axis=None))


def test_houses_are_tasks_of_the_median() -> None:
    values = np.array([[0.0, 10.0, 5.0], [2.0, 10.0, 9.0]])  # means of houses: 1, 10, 7
    assert median(values) == 7


def test_no_value_has_no_interval() -> None:
    nothing = np.full((2, 3), np.nan)
    for result in aggregates(nothing, scores=True).values():
        assert result == resampling.Interval(None, None)


def test_a_single_run_has_no_spread_over_runs() -> None:
    values = some_values(1, 30, 0.0)
    apart = interval(values, mean, Resampling.STRATIFIED)
    assert apart.ci95 == pytest.approx((apart.value, apart.value))
    low, high = interval(values, mean).ci95 or (0.0, 0.0)
    assert low < values.mean() < high


def test_a_weak_run_is_weak_in_all_houses_and_widens_the_interval() -> None:
    values = np.repeat([[0.1], [0.2], [0.9]], 60, axis=1)
    assert interval(values, mean).ci95 == (pytest.approx(0.1), pytest.approx(0.9))
    low, high = interval(values, mean, Resampling.STRATIFIED).ci95 or (0.0, 0.0)
    assert high - low < 0.25  # drawn apart in each house, no resample is of one run


shapes = st.sampled_from([(1, 1), (1, 6), (2, 3), (3, 2), (6, 1)])
matrices = st.builds(
    lambda shape, values: np.array(values[: shape[0] * shape[1]]).reshape(shape).tolist(),
    shapes,
    st.lists(st.floats(-10, 10), min_size=6, max_size=6),
)


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(matrices)
def test_statistics_lie_among_the_values_and_forget_the_order(matrix: Matrix) -> None:
    values = np.array(matrix)
    for statistic in (mean, median, iqm):
        result = statistic(values)
        assert values.min() - 1e-9 <= result <= values.max() + 1e-9
        assert statistic(values[::-1, ::-1].copy()) == pytest.approx(result, abs=1e-9)
        assert statistic(values + 3) == pytest.approx(result + 3, abs=1e-9)
        assert statistic(-values) == pytest.approx(-result, abs=1e-9)


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(matrices)
def test_an_interval_is_in_order_and_among_the_values(matrix: Matrix) -> None:
    values = np.array(matrix)
    low, high = interval(values, iqm, draws=30).ci95 or (0.0, 0.0)
    assert values.min() - 1e-9 <= low <= high <= values.max() + 1e-9


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(matrices)
def test_the_optimality_gap_is_never_negative_and_needs_no_better_than_1(matrix: Matrix) -> None:
    scores = np.array(matrix)
    assert optimality_gap(scores) >= -1e-9
    assert optimality_gap(np.minimum(scores, 1)) == pytest.approx(optimality_gap(scores))
    assert optimality_gap(np.maximum(scores, 1)) == pytest.approx(0)
