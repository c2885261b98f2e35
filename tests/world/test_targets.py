"""Which cell a robot has to clean next: against a flood, and against the plain world."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from marl_clean import keys
from marl_clean.env.for_schemes import asked_of_env
from marl_clean.env.targets import Targets
from marl_clean.errors import BadInput
from marl_clean.world import targets
from tests.observation.compared import assert_sees
from tests.reference import World, walking_distances
from tests.world.strategies import Case, cases


@pytest.mark.slow
@hypothesis_settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**20), maps=st.sampled_from([1, 3]))
def test_the_search_gives_what_a_flood_does(seed: int, maps: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    passable, goals = (
        torch.rand(4, maps, 5, 6, generator=generator) < share for share in (0.7, 0.15)
    )
    start = torch.randint(30, (4, 3), generator=generator)
    found = targets.nearest_goals(passable, goals, start)
    assert torch.equal(found, targets.flooded_goals(passable, goals, start))
    assert (found >= -1).all() and (found < 30).all()


def test_without_a_goal_there_is_none_and_of_equals_the_first_counts() -> None:
    passable = torch.ones(1, 1, 3, 3, dtype=torch.bool)
    goals = torch.zeros_like(passable)
    start = torch.tensor([[4]])
    assert targets.nearest_goals(passable, goals, start).tolist() == [[-1]]
    goals[0, 0, 1, 0] = goals[0, 0, 0, 1] = goals[0, 0, 0, 0] = True
    assert targets.nearest_goals(passable, goals, start).tolist() == [[1]]
    passable[0, 0, 0, 1] = False  # a goal that is not known to be free may be walked to
    assert targets.nearest_goals(passable, goals, start).tolist() == [[1]]


def expected(world: World, robot: int, index: int) -> list[int]:
    """(row, col, 1) from a robot to the nearest place that it has to clean, by plain sets."""
    known, here = world.map_of(robot), world.positions[robot]
    house = {(row, col) for row in range(world.rows) for col in range(world.cols)}
    free = {place for place, record in known.items() if not record.blocked}
    uncleaned = {p for p in free if known[p].cleaned is None or known[p].spilt}
    goals = (house - known.keys()) | uncleaned
    reached = {}
    for goal in goals:  # over what is known to be available, and then into the goal
        steps = walking_distances(free | {goal}, here)
        if goal in steps:
            reached[goal] = steps[goal]
    if not reached:
        return [0, 0, 0]
    row, col = min(reached, key=lambda goal: (reached[goal], goal))
    return [row - here[0], col - here[1], 1]


@pytest.mark.slow
@given(case=cases(max_agents=3))
@hypothesis_settings(max_examples=25, deadline=None)
def test_a_target_is_the_nearest_place_that_the_own_map_lacks(case: Case) -> None:
    assert_sees([case], Targets(), expected, keys.TARGET)


def test_an_entry_that_no_env_has_is_one_line() -> None:
    with pytest.raises(BadInput, match=r"\.reads=mood: no such entry; valid: target"):
        asked_of_env({"_target_": "theirs.Moody"}, "mood", learning=True)
