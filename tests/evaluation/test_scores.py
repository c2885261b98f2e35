"""Scores against the quotient of each house."""

import numpy as np
import pytest

from marl_clean.errors import BadInput
from marl_clean.evaluation.aggregates import optimality_gap
from marl_clean.evaluation.scores import scores_to_bound, scores_to_oracle, times


def house(time: int | None, bound: int | None = 10) -> dict:
    return {"T_100": time, "bound_100": bound, "max_steps": 250}


def test_a_score_is_the_bound_over_the_time_and_0_where_not_finished() -> None:
    runs = [[house(20), house(None), house(10)], [house(40), house(12), house(50, None)]]
    expected = [[0.5, 0.0, 1.0], [0.25, 10 / 12, np.nan]]
    np.testing.assert_allclose(scores_to_bound(runs), expected)
    assert optimality_gap(scores_to_bound(runs[:1])) == pytest.approx(0.5)


def test_a_house_that_is_clean_from_the_start_has_no_score() -> None:
    assert np.isnan(scores_to_bound([[house(0, 0)]])).all()


def test_an_oracle_may_be_beaten_and_counts_its_max_steps() -> None:
    runs, oracle = [[house(20), house(25), house(None)]], [[house(30), house(None), house(30)]]
    np.testing.assert_allclose(scores_to_oracle(runs, oracle), [[1.5, 10.0, 0.0]])
    assert optimality_gap(scores_to_oracle(runs, oracle)) == pytest.approx(1 / 3)
    with pytest.raises(BadInput, match="the same houses"):
        scores_to_oracle(runs, [[house(3)]])


def test_times_of_houses_not_finished_are_infinite() -> None:
    assert times([[house(20), house(None)]]).tolist() == [[20.0, np.inf]]
