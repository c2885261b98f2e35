"""The proven optimum agrees with a plain search over all schedules."""

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from marl_clean.commands import checks
from marl_clean.config.compose import checked, compose_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.bounds import bound_100
from marl_clean.evaluation.evaluator import measure_planner
from marl_clean.evaluation.optimum import optimal_T_100
from marl_clean.evaluation.records import counted
from tests.families import family
from tests.reference import Place, neighbour
from tests.world.strategies import grid, is_connected, several


def house_of(picture: str) -> np.ndarray:
    return np.array([[mark == "." for mark in line] for line in picture.split()])


def outcomes(free: set[Place], places: tuple[Place, ...]) -> Iterator[tuple[Place, ...]]:
    """Where robots can stand after one step, over all their joint actions (world.md)."""
    for actions in product(range(4), repeat=len(places)):
        after: list[Place] = []
        entered: set[Place] = set()
        for place, action in zip(places, actions, strict=True):
            target = neighbour(place, action)
            moves = target in free and target not in places and target not in entered
            entered |= {target} if moves else set()
            after.append(target if moves else place)
        yield tuple(after)


def plain_optimum(free: set[Place], starts: tuple[Place, ...]) -> int:
    """Breadth first over (places, cells cleaned)."""
    level = {(starts, frozenset(starts))}
    seen, steps = set(level), 0
    while all(cleaned != free for _, cleaned in level):
        level = {
            (after, cleaned | frozenset(after))
            for places, cleaned in level
            for after in set(outcomes(free, places))
        } - seen
        seen |= level
        steps += 1
    return steps


@st.composite
def small_houses(draw: st.DrawFn) -> tuple[set[Place], tuple[int, int], list[Place]]:
    """(free, shape, starts): up to 9 free cells, and fewer robots than cells."""
    rows, cols = draw(st.sampled_from([(1, 7), (7, 1), (2, 4), (3, 3), (4, 2), (3, 4), (5, 2)]))
    free = {(row, col) for row in range(rows) for col in range(cols)}
    for wall in draw(several(sorted(free), 5)):
        if len(free) > 3 and is_connected(free - {wall}):
            free.remove(wall)
    while len(free) > 9:
        free.remove(next(place for place in sorted(free) if is_connected(free - {place})))
    starts = draw(several(sorted(free), min(3, len(free) - 1), at_least=1))
    return free, (rows, cols), starts


@pytest.mark.slow
@given(small_houses())
@hypothesis_settings(max_examples=60, deadline=None)
def test_the_optimum_is_that_of_a_search_over_all_schedules(drawn) -> None:
    free, shape, starts = drawn
    house = np.array(grid(free, *shape))
    assert optimal_T_100(house, np.array(starts)) == plain_optimum(free, tuple(starts))


@pytest.mark.slow
def test_one_robot_in_a_comb_pays_for_each_tooth_but_the_last() -> None:
    comb = house_of("....... .#.#.#. .#.#.#.")
    assert optimal_T_100(comb, np.array([[2, 0]])) == 14 + 2 + 2
    assert optimal_T_100(comb, np.array([[0, 3]])) > bound_100(comb[None], np.array([[[0, 3]]]))[0]


def test_robots_that_block_each_other_need_longer_than_the_bound() -> None:
    """In a corridor nobody passes: two robots at one end are one robot and a spectator."""
    corridor = house_of(".........")
    assert optimal_T_100(corridor, np.array([[0, 4], [0, 5]])) == 4
    assert optimal_T_100(corridor, np.array([[0, 0], [0, 1]])) == 7


def test_what_cannot_be_proven_in_the_limit_is_null() -> None:
    house = np.ones((6, 7), dtype=bool)
    assert optimal_T_100(house, np.array([[2, 3]]), time_limit=1e-6) is None
    assert optimal_T_100(house, np.array([[2, 3], [3, 3]]), time_limit=1e-6) is None


SMALL = ["house.rows=[6, 7]", "house.cols=[6, 7]", "evaluation.houses=5"]


@family("n_agents", [1, 2], fast=1)
def test_an_evaluation_adds_the_optimum_and_the_gap_and_changes_nothing_else(n_agents) -> None:
    settings = [*SMALL, f"env.n_agents={n_agents}"]
    plain = measure_planner(compose_config(settings))
    known = measure_planner(compose_config([*settings, "evaluation.optimum=true"]))
    for house, other in zip(known["houses"], plain["houses"], strict=True):
        assert house["bound_100"] <= house["optimum_100"] <= house["T_100"]
        assert house["gap_100"] == house["T_100"] / house["optimum_100"] >= 1
        assert {name: house[name] for name in other} == other
        assert {*house} - {*other} == {"optimum_100", "gap_100"}
    assert {*known["summary"]} - {*plain["summary"]} == {"optimum_100", "gap_100"}
    assert {name: known["summary"][name] for name in plain["summary"]} == plain["summary"]
    gaps = [house["gap_100"] for house in known["houses"]]
    assert known["summary"]["gap_100"]["mean"] == pytest.approx(np.mean(gaps))


@pytest.mark.slow
def test_a_large_house_and_one_with_moving_furniture_have_no_optimum() -> None:
    optimum = ["evaluation.optimum=true", "evaluation.houses=2", "env.n_agents=1"]
    large = ["house.rows=[14, 14]", "house.cols=[14, 14]", "env.max_steps=3"]
    for settings in (large, [*SMALL[:2], "env.furniture_moves_per_episode=1"]):
        entry = measure_planner(compose_config([*optimum, *settings]))
        assert all(house["optimum_100"] is None for house in entry["houses"])
        assert all(house["gap_100"] is None for house in entry["houses"])
        assert entry["summary"]["gap_100"]["mean"] is None


def test_a_house_not_finished_counts_as_its_max_steps_in_the_gap() -> None:
    house = {"max_steps": 60, "T_100": None, "optimum_100": 20, "gap_100": None}
    assert counted(house, "gap_100") == 3.0
    assert counted({**house, "optimum_100": None}, "gap_100") is None
    assert counted({**house, "T_100": 30, "gap_100": 1.5}, "gap_100") == 1.5


def test_without_or_tools_the_optimum_is_bad_input_before_any_episode(monkeypatch) -> None:
    monkeypatch.setattr(checks, "is_installed", lambda name: False)
    with pytest.raises(BadInput, match=r"evaluation.optimum=true.*marl-clean\[optimum\]"):
        checks.check_optimum(compose_config(["evaluation.optimum=true"]))
    checks.check_optimum(compose_config([]))


@pytest.mark.slow
def test_the_config_of_an_earlier_run_may_lack_the_key() -> None:
    earlier = OmegaConf.to_container(compose_config(SMALL))
    del earlier["evaluation"]["optimum"]
    assert "gap_100" not in measure_planner(checked(earlier))["summary"]
