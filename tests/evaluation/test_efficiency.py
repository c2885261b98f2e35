"""Curves over training against plain loops over seeds and frames."""

import numpy as np
import pytest

from marl_clean.evaluation.aggregates import mean
from marl_clean.evaluation.efficiency import sample_efficiency
from marl_clean.evaluation.resampling import SEED
from tests.evaluation.test_aggregates import average, known, plain_iqm

SEEDS = [
    [(100.0, 5.0), (200.0, 4.0), (300.0, 1.0)],
    [(100.0, 9.0), (200.0, 2.0)],  # stopped early
    [(100.0, 7.0), (300.0, 3.0), (200.0, 3.0)],
    [(100.0, 8.0), (200.0, 6.0), (200.0, 1.0), (300.0, 2.0)],  # 200 was logged again
]
BY_SEED = [[5.0, 4.0, 1.0], [9.0, 2.0, np.nan], [7.0, 3.0, 3.0], [8.0, 1.0, 2.0]]


@pytest.mark.parametrize("statistic", ["iqm", "mean"])
def test_each_frame_is_the_statistic_over_its_seeds(statistic: str) -> None:
    plain = average if statistic == "mean" else lambda values: plain_iqm([values])
    functions = {"statistic": mean} if statistic == "mean" else {}
    curve = sample_efficiency(SEEDS, draws=50, **functions)
    assert curve is not None
    assert curve.frames.tolist() == [100, 200, 300] and curve.seeds.tolist() == [4, 4, 3]
    columns = [list(column) for column in zip(*BY_SEED, strict=True)]
    assert curve.value == pytest.approx([plain(column) for column in columns])
    rng = np.random.default_rng(SEED)
    drawn = [[rng.integers(4) for _ in range(4)] for _ in range(50)]
    for place, column in enumerate(columns):
        ends = known([plain([column[seed] for seed in seeds]) for seeds in drawn])
        low, high = np.percentile(ends, [2.5, 97.5])
        assert (curve.low[place], curve.high[place]) == pytest.approx((low, high))


def test_a_single_seed_has_a_curve_and_no_interval() -> None:
    curve = sample_efficiency(SEEDS[:1])
    assert curve is not None and curve.value.tolist() == [5, 4, 1]
    assert np.isnan(curve.low).all() and np.isnan(curve.high).all()
    late = sample_efficiency([SEEDS[0], SEEDS[1]])
    assert late is not None and late.seeds.tolist() == [2, 2, 1]
    assert np.isnan(late.low).tolist() == [False, False, True]


def test_nothing_logged_has_no_curve() -> None:
    assert sample_efficiency([]) is None
    assert sample_efficiency([[], []]) is None
