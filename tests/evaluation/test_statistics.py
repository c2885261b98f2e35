"""The intervals are those of a plain loop, and know of runs as well as of houses."""

import math

import numpy as np
import pytest
from scipy.stats import norm, t, ttest_rel

from marl_clean.errors import BadInput
from marl_clean.evaluation import statistics
from marl_clean.evaluation.statistics import (
    as_sample,
    bootstrap_means,
    estimate,
    holm,
    paired_difference,
    paired_p,
)


def plain_bootstrap(values, rng, draws):
    """The two-level bootstrap as one would say it aloud, drawing in the same order."""
    runs, houses = len(values), len(values[0])
    chosen_runs = [[rng.integers(runs) for _ in range(runs)] for _ in range(draws)]
    means = [[] for _ in range(draws)]
    for place in range(runs):
        for draw in range(draws):
            run = values[chosen_runs[draw][place]]
            picked = [run[rng.integers(houses)] for _ in range(houses)]
            known = [value for value in picked if not np.isnan(value)]
            if known:
                means[draw].append(sum(known) / len(known))
    return [sum(row) / len(row) if row else np.nan for row in means]


@pytest.mark.parametrize("runs", [1, 3])
@pytest.mark.parametrize("missing", [0.0, 0.5])
def test_bootstrap_equals_the_plain_loop(runs, missing, monkeypatch):
    monkeypatch.setattr(statistics, "_BLOCK", 35)  # several blocks, the last one ragged
    rng = np.random.default_rng(1)
    values = rng.normal(size=(runs, 7))
    values[rng.random(values.shape) < missing] = np.nan
    statistics._resamples.cache_clear()
    fast = bootstrap_means(values, 5, 52)
    slow = plain_bootstrap(values.tolist(), np.random.default_rng(5), 52)
    np.testing.assert_allclose(fast, slow, rtol=1e-12)


def test_interval_of_one_run_is_the_normal_one_of_the_mean():
    values = np.random.default_rng(2).normal(10.0, 3.0, size=(1, 400))
    result = estimate(values)
    half = norm.ppf(0.975) * values.std() / 20
    assert result.mean == pytest.approx(values.mean())
    assert result.ci95 == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)


def test_runs_that_differ_widen_the_interval_though_their_houses_agree():
    values = np.repeat([[1.0], [2.0], [6.0]], 50, axis=1)
    assert estimate(values).ci95 == (1.0, 6.0)  # all three draws may be the same run
    assert estimate(values.reshape(1, -1)).ci95[1] < 4.0  # houses alone do not know that


def test_houses_are_drawn_anew_within_each_run():
    values = np.tile([[0.0, 1.0]], (4, 1))
    means = bootstrap_means(values, 0, 2_000)
    # Drawn once for all runs only 0, 1/2 and 1 could appear.
    assert len(np.unique(means)) == 9


def test_the_same_values_give_the_same_interval():
    values = np.random.default_rng(3).normal(size=(3, 20))
    assert estimate(values) == estimate(values)


def test_no_value_has_no_estimate():
    nothing = as_sample([[None, None]])
    assert estimate(nothing) == statistics.Estimate(None, None)


def test_paired_difference_forgets_what_houses_share():
    rng = np.random.default_rng(4)
    hardness = rng.normal(100.0, 30.0, size=(1, 80))
    ours = hardness + rng.normal(-5.0, 1.0, size=(3, 80))
    paired = paired_difference(ours, hardness)
    assert paired.mean == pytest.approx((ours - hardness).mean())
    low, high = paired.ci95
    assert -6.0 < low < high < -4.0  # far narrower than the houses' spread


def test_what_cannot_be_paired_is_bad_input():
    with pytest.raises(BadInput, match="same houses"):
        paired_difference(np.zeros((1, 3)), np.zeros((1, 4)))
    with pytest.raises(BadInput, match="as many on both sides"):
        paired_difference(np.zeros((2, 3)), np.zeros((3, 3)))


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def plain_p(differences) -> float:
    """The same in plain sums: t of the mean over what runs and houses make it vary."""
    runs, houses = len(differences), len(differences[0])

    def squared_error(means):
        middle = sum(means) / len(means)
        spread = sum((mean - middle) ** 2 for mean in means)
        return spread / (len(means) - 1) / len(means)

    of_runs = [sum(run) / houses for run in differences]
    of_houses = [sum(house) / runs for house in zip(*differences, strict=True)]
    squares = (squared_error(of_runs) if runs > 1 else 0) + squared_error(of_houses)
    degrees = min(runs if runs > 1 else houses, houses) - 1
    return 2 * t.sf(abs(sum(of_runs) / runs) / math.sqrt(squares), degrees)


@pytest.mark.parametrize("runs", [1, 2, 5])
def test_p_is_that_of_the_plain_sums(runs) -> None:
    rng = np.random.default_rng(5)
    first, second = rng.normal(0.3, 1, (runs, 7)), rng.normal(0, 1, (1, 7))
    assert paired_p(first, second) == pytest.approx(plain_p((first - second).tolist()))


def test_p_of_one_run_is_the_paired_t_test_over_its_houses() -> None:
    first, second = np.random.default_rng(6).normal(size=(2, 1, 30))
    assert paired_p(first, second) == pytest.approx(ttest_rel(first[0], second[0]).pvalue)


@pytest.mark.parametrize("runs", [2, 3, 5])
def test_runs_that_differ_by_chance_are_rarely_called_different(runs) -> None:
    # As runs of this project differ: far more from seed to seed than the houses explain.
    rng = np.random.default_rng(7)
    alarms = 0
    for _ in range(600):
        of_runs, of_houses = rng.normal(0, 8, (runs, 1)), rng.normal(0, 20, (1, 50))
        values = of_runs + of_houses + rng.normal(0, 39, (runs, 50))
        alarms += paired_p(values, np.zeros((1, 50))) < 0.05
    assert alarms <= 600 * 0.075  # 5 %, and three standard errors of 600 trials


def test_p_without_a_value_or_without_any_spread() -> None:
    nothing = np.zeros((2, 9))
    assert paired_p(np.full((2, 9), np.nan), nothing) == 1.0
    assert paired_p(nothing, nothing) == 1.0
    assert paired_p(nothing - 5, nothing) == 0.0
    assert paired_p(np.array([[3.0]]), np.array([[0.0]])) == 1.0  # one number has no spread
    holed = np.array([[1.0, np.nan, 2.0], [np.nan, np.nan, 1.5]])  # both runs' mean is 1.5
    error = np.sqrt(np.var([1.0, 1.75], ddof=1) / 2)
    assert paired_p(holed, np.zeros((1, 3))) == pytest.approx(2 * t.sf(1.5 / error, 1))
