"""Ratios and recovered headroom, computed a second time by plain loops that draw in one order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marl_clean.errors import BadInput
from marl_clean.evaluation.ratios import ratio_of_means, recovered_headroom
from marl_clean.evaluation.resampling import SEED, Resampling

RUNS, HOUSES, DRAWS = 4, 6, 300


def times(level: float, seed: int, runs: int = RUNS) -> np.ndarray:
    """Steps in houses that are slow or fast for everybody."""
    house = np.linspace(-30, 30, HOUSES)
    return level + house + np.random.default_rng(seed).normal(0, 4, (runs, HOUSES))


SILENT, ARM, ORACLE = times(200, 1), times(170, 2), times(120, 3)


def drawn_places(how: Resampling) -> list[list[list[tuple[int, int]]]]:
    """Of each draw, which run and house stand at each place."""
    rng = np.random.default_rng(SEED)
    apart = how is Resampling.STRATIFIED
    run = rng.integers(RUNS, size=(DRAWS, RUNS, HOUSES if apart else 1))
    house = None if apart else rng.integers(HOUSES, size=(DRAWS, 1, HOUSES))
    return [
        [
            [
                (run[draw, r, h if apart else 0], h if house is None else house[draw, 0, h])
                for h in range(HOUSES)
            ]
            for r in range(RUNS)
        ]
        for draw in range(DRAWS)
    ]


def mean_at(values: np.ndarray, places: list[list[tuple[int, int]]]) -> float:
    """A plain mean over all places."""
    taken = [values[r if len(values) > 1 else 0, h] for line in places for r, h in line]
    return sum(taken) / len(taken)


@pytest.mark.parametrize("how", list(Resampling))
def test_a_ratio_is_that_of_plain_loops(how: Resampling) -> None:
    measured = ratio_of_means(SILENT, ARM, how, DRAWS)
    assert measured.value == pytest.approx(np.mean(SILENT) / np.mean(ARM))
    ratios = [mean_at(SILENT, places) / mean_at(ARM, places) for places in drawn_places(how)]
    assert measured.ci95 == pytest.approx(tuple(np.percentile(ratios, [2.5, 97.5])))


@pytest.mark.parametrize("how", list(Resampling))
@pytest.mark.parametrize("oracle", [ORACLE, ORACLE[:1]], ids=["runs", "planner"])
def test_what_is_recovered_is_that_of_plain_loops(how: Resampling, oracle: np.ndarray) -> None:
    measured = recovered_headroom(SILENT, ARM, oracle, how, DRAWS)
    gap = np.mean(SILENT) - np.mean(oracle)
    assert measured.gap.value == pytest.approx(gap)
    assert measured.share.value == pytest.approx((np.mean(SILENT) - np.mean(ARM)) / gap)
    gaps, shares = [], []
    for places in drawn_places(how):
        silent, arm, end = (mean_at(side, places) for side in (SILENT, ARM, oracle))
        gaps.append(silent - end)
        shares.append((silent - arm) / (silent - end))
    assert measured.gap.ci95 == pytest.approx(tuple(np.percentile(gaps, [2.5, 97.5])))
    assert measured.share.ci95 == pytest.approx(tuple(np.percentile(shares, [2.5, 97.5])))


def test_silent_recovers_nothing_and_the_oracle_everything() -> None:
    for arm, share in ((SILENT, 0.0), (ORACLE, 1.0)):
        measured = recovered_headroom(SILENT, arm, ORACLE).share
        assert measured.value == pytest.approx(share)
        assert measured.ci95 == pytest.approx((share, share))


def test_no_clear_gap_gives_no_number() -> None:
    for oracle in (times(200, 9), times(230, 9)):
        measured = recovered_headroom(SILENT, ARM, oracle)
        assert measured.share.value is None and not measured.is_clear
        assert measured.gap.ci95 is not None and measured.gap.ci95[0] <= 0


def test_pairing_leaves_houses_out_of_the_interval() -> None:
    """Houses differ by 60 steps, and a ratio of the same times everywhere not at all."""
    low, high = ratio_of_means(2 * SILENT, SILENT).ci95 or (0, 0)
    assert (low, high) == pytest.approx((2, 2))


@pytest.mark.slow
@given(st.integers(0, 1000), st.floats(0.1, 10), st.floats(-50, 50))
@settings(max_examples=30, deadline=None)
def test_units_and_a_shift_of_all_leave_what_is_recovered(
    seed: int, unit: float, shift: float
) -> None:
    sides = [times(level, seed + place) for place, level in enumerate((200, 160, 110))]
    first = recovered_headroom(*sides, draws=100).share
    moved = recovered_headroom(*(unit * side + shift for side in sides), draws=100).share
    assert moved.value == pytest.approx(first.value)
    assert moved.ci95 == pytest.approx(first.ci95)


def test_a_house_without_a_value_is_left_out_on_all_sides() -> None:
    holed = ARM.copy()
    holed[:, 2] = np.nan
    kept = [0, 1, 3, 4, 5]
    measured = ratio_of_means(holed, SILENT)
    assert measured.value == pytest.approx(np.mean(ARM[:, kept]) / np.mean(SILENT[:, kept]))
    assert ratio_of_means(np.full_like(ARM, np.nan), SILENT).value is None
    assert ratio_of_means(ARM, np.zeros_like(ARM)).value is None


def test_sides_of_unequal_size_are_refused() -> None:
    with pytest.raises(BadInput, match="4 runs of 6 houses, 3 runs of 6 houses"):
        ratio_of_means(SILENT, ARM[:3])
    with pytest.raises(BadInput, match="4 runs of 5 houses"):
        recovered_headroom(SILENT, ARM[:, :5], ORACLE)
