"""Rules are decided by planted numbers as they should be; interval and test never disagree."""

import numpy as np
import pytest

from marl_clean.evaluation.rules import CLAIMS, Claim, Effect, Form, Outcome, decide, effect
from marl_clean.evaluation.statistics import paired_difference, paired_p

CONFIDENCE = 0.95
MET, NOT_MET, UNDECIDED = Outcome.MET, Outcome.NOT_MET, Outcome.UNDECIDED


def planted(mean: float, seed: int, runs: int = 3, spread: float = 1.0) -> np.ndarray:
    """Times of `runs` runs in 40 houses that vary far more than the runs do."""
    houses = np.random.default_rng(0).normal(0, 10, 40)
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, spread, (runs, 1)) + rng.normal(0, 1, (runs, 40))
    return mean + houses + noise - noise.mean()


def outcome_of(claim: Claim, values: np.ndarray, baseline: np.ndarray | None) -> Outcome:
    [(_, outcome)] = decide([effect(claim, values, baseline, CONFIDENCE)], CONFIDENCE)
    return outcome


@pytest.mark.parametrize(
    ("key", "bound", "outcome"),
    [
        ("ratio_below", 0.95, MET),  # the ratio is 0.9
        ("ratio_below", 0.85, NOT_MET),
        ("ratio_below", 0.9, UNDECIDED),
        ("ratio_above", 0.85, MET),
        ("ratio_above", 0.95, NOT_MET),
        ("difference_below", -5.0, MET),  # the difference is -10
        ("difference_below", -15.0, NOT_MET),
        ("difference_below", -10.0, UNDECIDED),
        ("difference_above", -15.0, MET),
        ("difference_above", 0.0, NOT_MET),
        ("below", 100.0, MET),  # the mean is 90
        ("below", 80.0, NOT_MET),
        ("below", 90.5, UNDECIDED),
        ("above", 80.0, MET),
    ],
)
def test_three_outcomes(key: str, bound: float, outcome: Outcome) -> None:
    form, below = CLAIMS[key]
    baseline = None if form is Form.MEAN else planted(100, 2)
    assert outcome_of(Claim(form, bound, below), planted(90, 1), baseline) is outcome


def test_what_two_seeds_that_disagree_say_is_undecided() -> None:
    """Each of 40 houses is sooner, by far in one of the seeds: no answer for other seeds."""
    baseline = np.full((2, 40), 100.0)
    values = baseline - np.array([[1.0], [30.0]])
    claim = Claim(Form.DIFFERENCE, 0.0, below=True)
    assert outcome_of(claim, values, baseline) is UNDECIDED
    low, high = paired_difference(values, baseline).ci95  # a bootstrap of two would call it met
    assert high < 0


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("runs", [1, 2, 5])
def test_interval_and_test_agree(form: Form, runs: int) -> None:
    values, baseline = planted(90, 3, runs), planted(100, 4, runs)
    claim = Claim(form, 0.9, below=True)
    result = effect(claim, values, None if form is Form.MEAN else baseline, CONFIDENCE)
    assert result.interval is not None and result.value is not None
    assert result.interval[0] < result.value < result.interval[1]
    for end in result.interval:
        other = baseline if form is Form.RATIO else np.ones_like(values)
        first = values - baseline if form is Form.DIFFERENCE else values
        assert paired_p(first, end * other) == pytest.approx(1 - CONFIDENCE, rel=1e-6)


def test_a_planner_is_paired_with_every_seed() -> None:
    values, planner = planted(90, 5), planted(100, 6)[:1]
    for form in (Form.RATIO, Form.DIFFERENCE):
        claim = Claim(form, 0.95 if form is Form.RATIO else -5.0, below=True)
        apart = effect(claim, values, planner, CONFIDENCE)
        repeated = effect(claim, values, np.repeat(planner, 3, axis=0), CONFIDENCE)
        assert apart == repeated and apart.right_side


def test_where_there_is_no_value_nothing_is_decided() -> None:
    nothing = np.full((3, 4), np.nan)
    claim = Claim(Form.RATIO, 0.9, below=True)
    assert effect(claim, nothing, nothing, CONFIDENCE) == Effect(None, None, 1.0, False)
    over_zero = effect(claim, np.ones((3, 4)), np.zeros((3, 4)), CONFIDENCE)
    assert over_zero.value is None and not over_zero.right_side
    part = planted(90, 1)
    part[:, ::2] = np.nan  # of which a house without a value is left out
    whole = effect(claim, part[:, 1::2], planted(100, 2)[:, 1::2], CONFIDENCE)
    assert effect(claim, part, planted(100, 2), CONFIDENCE).value == pytest.approx(whole.value)


def test_a_baseline_that_may_be_0_bounds_no_ratio() -> None:
    baseline = np.array([[1.0, 2.0], [-1.0, -1.5]])
    result = effect(Claim(Form.RATIO, 0.9, True), np.ones((2, 2)), baseline, CONFIDENCE)
    assert result.interval is None


def test_rules_are_corrected_for_each_other_and_for_those_that_lack_runs() -> None:
    clear, weak = (Effect(0.9, (0.8, 0.99), p, right_side=True) for p in (0.001, 0.03))
    assert [o for _, o in decide([clear, weak], CONFIDENCE)] == [MET, MET]
    assert decide([weak], CONFIDENCE) == [(0.03, MET)]
    assert decide([weak, None], CONFIDENCE) == [(0.06, UNDECIDED), (1.0, UNDECIDED)]
    wrong = Effect(1.2, (1.1, 1.3), 0.001, right_side=False)
    assert [o for _, o in decide([wrong, clear], CONFIDENCE)] == [NOT_MET, MET]
