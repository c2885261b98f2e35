"""Boustrophedon and spiral take the steps that a literal reading of their rules takes."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.planner.base import Sweep
from marl_clean.planner.boustrophedon import Boustrophedon
from marl_clean.planner.spiral import Spiral
from tests import reference
from tests.reference import DIRTY, Place, neighbours, search, value
from tests.world.play import env_of, start
from tests.world.strategies import Case, cases

UP, RIGHT, DOWN, LEFT = range(4)
ORDERS: dict[type[Sweep], Callable[[int], list[int]]] = {
    Boustrophedon: lambda heading: [UP, DOWN, RIGHT, LEFT],
    Spiral: lambda heading: [(heading + shift) % 4 for shift in (3, 0, 1, 2)],
}


def is_open(world: reference.World, robot: int, place: Place) -> bool:
    """Unknown, or known to be available and not cleaned since the episode began."""
    record = world.map_of(robot).get(place)
    return record is None or (not record.blocked and record.cleaned is None)


def sweep(world: reference.World, robot: int, order: list[int]) -> int | None:
    """The action that the rules name, None where any will do."""
    here = world.positions[robot]
    reached = search(world, robot)
    beside = neighbours(here)
    for action in order:
        if beside[action] in reached and is_open(world, robot, beside[action]):
            return action
    known, elsewhere = world.map_of(robot), [place for place in reached if place != here]
    for place in elsewhere:
        if is_open(world, robot, place):
            return reached[place][1]
    for place in elsewhere:
        if value(known.get(place), world.steps, world.settings) == DIRTY:
            return reached[place][1]
    return None


@pytest.mark.long
@given(case=cases(max_agents=3), planner=st.sampled_from([Boustrophedon, Spiral]))
@hypothesis_settings(max_examples=30, deadline=None)
def test_every_step_is_the_rule_taken_literally(case: Case, planner: type[Sweep]) -> None:
    env, world = env_of([case]), case.world()
    policy, td = planner().bind(env.base_env), start(env, [case])
    places, headings = list(case.starts), [UP] * len(case.starts)
    for _ in range(20):
        for robot, place in enumerate(world.positions):
            if place != places[robot]:
                headings[robot] = neighbours(places[robot]).index(place)
                places[robot] = place
        td = policy(td)
        actions = td[keys.ACTION][0].tolist()
        for robot, action in enumerate(actions):
            wanted = sweep(world, robot, ORDERS[planner](headings[robot]))
            assert wanted is None or action == wanted
        td = env.step(td)
        outcome = world.step(actions)
        if outcome.terminated or outcome.truncated:
            break
        td = step_mdp(td)


def places_in(planner: type[Sweep], lines: list[str], first: Place, steps: int) -> list[list[int]]:
    free = [[mark == "." for mark in line] for line in lines]
    settings = reference.Settings(sensor=reference.Sensor.TOUCH4)
    case = Case(free, [[0] * len(lines[0])] * len(lines), [first], settings, [], None, [])
    env = env_of([case])
    rollout = env.rollout(steps, planner().bind(env.base_env), break_when_any_done=False)
    return rollout["next", "agents", "position"][0, :, 0].tolist()


@pytest.mark.parametrize(
    ("planner", "first", "expected"),
    [
        (
            Boustrophedon,
            (2, 0),
            [(1, 0), (0, 0), (0, 1), (1, 1), (2, 1), (2, 2), (1, 2), (0, 2), (0, 3), (1, 3)],
        ),
        (
            Spiral,
            (0, 0),
            [(0, 1), (0, 2), (0, 3), (1, 3), (2, 3), (2, 2), (2, 1), (2, 0), (1, 0), (1, 1)],
        ),
    ],
)
def test_an_open_room_shows_what_they_are_named_after(planner, first, expected) -> None:
    assert places_in(planner, ["...."] * 3, first, 10) == [list(place) for place in expected]
