"""Protocols and their share, against SciPy's exact interval and the definition in plain words."""

import numpy as np
import pytest
from scipy.stats import binomtest

from marl_clean.evaluation.gains import (
    clopper_pearson,
    forms_protocol,
    gain_cells,
    protocols_of,
    recovered_of,
)
from marl_clean.evaluation.paired import Row
from marl_clean.evaluation.records import MEASURES, Entry, make_entry

HOUSES = 30
NOISE = np.random.default_rng(0).normal(0, 2, HOUSES)


def entry(level: float) -> Entry:
    """A run that needs `level` steps, more or less, in houses alike for all."""
    houses = []
    for place in range(HOUSES):
        time = int(round(level + 3 * place + NOISE[(place + int(level)) % HOUSES]))
        record = {measure: 1.0 for measure in MEASURES if not measure.endswith("certify")}
        record |= {"seed": place, "rows": 9, "cols": 9, "free_cells": 40, "max_steps": 900}
        record |= {f"bound_{name}": 10 for name in ("90", "95", "99", "100")}
        houses.append(record | {"T_90": time, "T_100": time + 20})
    return make_entry("run", "test", "hash", 0.02, 2, houses)


def row(label: str, *levels: float) -> Row:
    return Row(label, {seed: entry(level) for seed, level in enumerate(levels)})


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (1, 10), (8, 10), (10, 10), (3, 7)])
def test_the_interval_is_clopper_and_pearsons(successes: int, trials: int) -> None:
    exact = binomtest(successes, trials).proportion_ci(0.95, method="exact")
    assert clopper_pearson(successes, trials) == pytest.approx((exact.low, exact.high))


@pytest.mark.slow
def test_a_seed_counts_that_beats_silence_is_heard_and_loses_it_zeroed() -> None:
    """Seeds: a protocol; no gain; a gain that is not heard; heard, but better without too."""
    silent = row("silent", 200, 200, 200, 200, 200)
    arm = row("arm", 150, 200, 150, 150, 150)
    zeroed = {0: entry(210), 1: entry(230), 2: entry(150), 3: entry(180)}  # of seed 4 unknown
    share = protocols_of(arm, silent, zeroed)
    assert share["seeds"] == [0, 1, 2, 3] and share["formed"] == [0]
    assert share["value"] == 0.25 and share["ci95"] == pytest.approx(clopper_pearson(1, 4))
    assert protocols_of(arm, silent, {})["value"] is None
    alone = protocols_of(arm, Row("silent", {9: entry(200)}), zeroed)
    assert alone["seeds"] == [] and alone["value"] is None  # no twin


def test_each_of_the_three_conditions_decides() -> None:
    silent = np.full((1, HOUSES), 200.0) + NOISE
    swings = np.where(np.arange(HOUSES) % 2, 40.0, -40.0)[None]
    assert forms_protocol(silent, silent - 30, silent)
    assert not forms_protocol(silent, silent, silent + 30)  # gains nothing
    assert not forms_protocol(silent, silent - 30, silent - 10)  # zeroed it is better than silent
    assert not forms_protocol(silent, silent - 3, silent + swings)  # whether heard is chance
    assert not forms_protocol(silent, silent - 30 + 4 * swings, silent + 1)  # the gain is chance


@pytest.mark.slow
def test_seeds_that_all_have_are_paired_and_a_planner_with_each() -> None:
    silent, arm = row("silent", 200, 210, 190), row("arm", 150, 160)
    planner = Row("merged", {None: entry(100)})
    recovered = recovered_of(arm, silent, planner)
    assert recovered["seeds"] == [0, 1]
    levels = [[np.mean([h["T_90"] for h in e["houses"]]) for e in side.runs.values()] for side in
              (silent, arm, planner)]  # fmt: skip
    start, own, end = np.mean(levels[0][:2]), np.mean(levels[1]), levels[2][0]
    assert recovered["T_90"]["value"] == pytest.approx((start - own) / (start - end))
    assert recovered["T_90"]["gap"]["value"] == pytest.approx(start - end)
    nobody = recovered_of(Row("arm", {7: entry(1)}), silent, planner)
    assert nobody["T_90"]["value"] is None and nobody["seeds"] == []


@pytest.mark.slow
def test_cells_say_why_there_is_no_number() -> None:
    silent, arm = row("silent", 200, 210), row("arm", 150, 160)
    clear = {"recovered": recovered_of(arm, silent, row("oracle", 100, 100))}
    poor = {"recovered": recovered_of(arm, silent, row("oracle", 200, 210))}
    share = {"protocols": protocols_of(arm, silent, {0: entry(230), 1: entry(230)})}
    titles, *lines = gain_cells([clear, poor, share])
    assert titles == ["recovered T_90", "recovered T_100", "protocols"]
    assert lines[0][0].startswith("0.") and lines[0][2] == "-"
    assert lines[1][:2] == ["no headroom", "no headroom"]
    assert lines[2] == ["-", "-", "2 of 2 [0.16, 1.00]"]
    assert gain_cells([{}, {}]) == [[], [], []]
