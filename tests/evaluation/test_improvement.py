"""P(X > Y) against counting pairs, and against scipy's Mann-Whitney U."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from marl_clean.errors import BadInput
from marl_clean.evaluation.improvement import probability_of_improvement
from marl_clean.evaluation.resampling import SEED, Interval, Resampling
from tests.evaluation.test_aggregates import average

Matrix = list[list[float]]


def plain_probability(better: Matrix, baseline: Matrix) -> float:
    """Every pair of runs in every house, compared one after the other."""
    of_houses = []
    for house in range(len(better[0])):
        points = []
        for x in (run[house] for run in better):
            for y in (run[house] for run in baseline):
                if x != x or y != y:
                    continue
                points.append(1.0 if x > y else 0.5 if x == y else 0.0)
        of_houses.append(average(points))
    return average(of_houses)


def drawn(values: Matrix, runs: Any, houses: Any) -> Matrix:
    """A resample; `runs[place]` has a run for all houses, or one for each."""
    return [
        [values[run[house % len(run)]][houses[house]] for house in range(len(houses))]
        for run in runs
    ]


@pytest.mark.parametrize("how", Resampling)
@pytest.mark.parametrize(("runs", "others"), [(1, 1), (3, 2), (4, 1)])
def test_it_is_the_count_of_pairs_and_so_are_its_resamples(
    how: Resampling, runs: int, others: int
) -> None:
    rng = np.random.default_rng(3)
    better = rng.integers(0, 6, (runs, 7)).astype(float)  # with ties
    baseline = rng.integers(0, 5, (others, 7)).astype(float)
    better[0, 2], baseline[0, 4], better[-1, 1] = np.nan, np.nan, -np.inf
    result = probability_of_improvement(better, baseline, how, draws=30)
    x, y = better.tolist(), baseline.tolist()
    assert result.value == pytest.approx(plain_probability(x, y))
    again = np.random.default_rng(SEED)
    apart = 7 if how is Resampling.STRATIFIED else 1
    for_x, for_y = (again.integers(n, size=(30, n, apart)) for n in (runs, others))
    houses = [range(7)] * 30
    if how is Resampling.RUNS_AND_HOUSES:
        houses = again.integers(7, size=(30, 7)).tolist()
    ends = [
        plain_probability(drawn(x, for_x[draw], houses[draw]), drawn(y, for_y[draw], houses[draw]))
        for draw in range(30)
    ]
    assert result.ci95 == pytest.approx(np.nanpercentile(ends, [2.5, 97.5]))


def test_it_is_mann_whitneys_u_averaged_over_houses() -> None:
    rng = np.random.default_rng(4)
    better, baseline = rng.integers(0, 5, (6, 11)), rng.integers(0, 4, (5, 11))
    u = mannwhitneyu(better, baseline, axis=0, alternative="greater").statistic / 30
    result = probability_of_improvement(better.astype(float), baseline.astype(float))
    assert result.value == pytest.approx(u.mean())


@pytest.mark.slow
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.sampled_from([-np.inf, 0.0, 1.0, 2.0]), min_size=4, max_size=4),
    st.lists(st.sampled_from([-np.inf, 0.0, 1.0, 2.0]), min_size=4, max_size=4),
)
def test_the_two_sides_sum_to_1_and_a_policy_is_no_better_than_itself(
    first: list[float], second: list[float]
) -> None:
    x, y = (np.array(values).reshape(2, 2) for values in (first, second))
    one, other = (probability_of_improvement(*pair, draws=20) for pair in ((x, y), (y, x)))
    assert (one.value or 0) + (other.value or 0) == pytest.approx(1)
    assert probability_of_improvement(x, x, draws=20).value == 0.5
    low, high = one.ci95 or (-1.0, -1.0)
    assert 0 <= low <= high <= 1


def test_only_the_order_counts() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.normal(size=(3, 9)), rng.normal(size=(3, 9))
    assert probability_of_improvement(x, y) == probability_of_improvement(np.exp(x), np.exp(y))
    assert probability_of_improvement(x + 100, y) == Interval(1.0, (1.0, 1.0))


def test_without_a_common_value_there_is_none_and_other_houses_are_refused() -> None:
    nothing = np.full((2, 3), np.nan)
    assert probability_of_improvement(nothing, np.zeros((1, 3))) == Interval(None, None)
    with pytest.raises(BadInput, match="the same houses, not 3 and 4"):
        probability_of_improvement(nothing, np.zeros((1, 4)))
