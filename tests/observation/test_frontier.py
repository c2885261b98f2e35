"""The frontier plane is what a plain search over the robots' map gives."""

from collections import deque

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs import Compose, TransformedEnv

from marl_clean import keys
from marl_clean.observation.frontier import Frontier
from tests import reference
from tests.observation.plain import believed
from tests.world.play import env_of, follow, topology_of
from tests.world.strategies import Case, cases

SIDE = 5
STEPS = 6


def steps_to_frontier(world: reference.World, robot: int) -> dict[reference.Place, int]:
    """Walking distances to the nearest unknown or dirty cell, over cells known to be free."""
    known = world.map_of(robot)
    matrix = [(r, c) for r in range(-1, world.rows + 1) for c in range(-1, world.cols + 1)]
    free = {place for place in matrix if place in known and not known[place].blocked}

    def is_goal(place: reference.Place) -> bool:
        record = known.get(place)
        return record is None or reference.value(record, world.steps, world.settings) == 0

    steps = {place: 0 for place in matrix if is_goal(place)}
    queue = deque(steps)
    while queue:
        row, col = queue.popleft()
        for near in ((row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)):
            if near in free and near not in steps:
                steps[near] = steps[row, col] + 1
                queue.append(near)
    return steps


def expected_plane(
    world: reference.World, robot: int, centre: reference.Place, side: int
) -> torch.Tensor:
    distance = steps_to_frontier(world, robot)
    row, col = centre
    plane = torch.zeros(side, side)
    if (row, col) not in distance:
        return plane
    own = distance[row, col]
    for r in range(side):
        for c in range(side):
            place = (row + r - side // 2, col + c - side // 2)
            nearer = (own - distance[place]) / side if place in distance else -1.0
            plane[r, c] = min(1.0, max(-1.0, nearer))
    return plane


@pytest.mark.slow
@given(
    case=cases(max_agents=3),
    side=st.sampled_from([1, 3, 5, 7]),
    noise=st.sampled_from([0.0, 0.0, 0.5]),
)
@hypothesis_settings(max_examples=20, deadline=None)
def test_the_plane_is_a_plain_searchs(case: Case, side: int, noise: float) -> None:
    assert_plane([case], side, noise)


@pytest.mark.slow
@given(data=st.data())
@hypothesis_settings(max_examples=10, deadline=None)
def test_a_larger_house_beside_it_changes_no_plane(data: st.DataObject) -> None:
    first = data.draw(cases(max_agents=2))
    n_agents = len(first.starts)
    same = cases(st.just(first.settings), n_agents).filter(lambda c: len(c.starts) == n_agents)
    assert_plane([first, data.draw(same)], 7, 0.0)


def assert_plane(drawn: list[Case], side: int, noise: float) -> None:
    base = env_of(drawn).base_env
    env = TransformedEnv(base, Compose(topology_of(drawn[0].settings), Frontier(side, noise)))
    for frame, worlds in follow(env, drawn, STEPS):
        for index, world in worlds:
            for robot in range(world.n_agents):
                centre = believed(world, robot, noise, index)
                plane = frame[keys.OBSERVATION][index, robot, 1]
                expected = expected_plane(world, robot, centre, side)
                torch.testing.assert_close(plane, expected, atol=1e-6, rtol=0)


def test_the_first_channel_is_the_crop() -> None:
    case = Case(
        [[True] * 5] * 3, [[0] * 5] * 3, [(0, 0), (2, 4)], reference.Settings(), [], None, []
    )
    base = env_of([case]).base_env
    env = TransformedEnv(base, Compose(topology_of(case.settings), Frontier(SIDE)))
    observation = env.reset()[keys.OBSERVATION]
    assert observation.shape == (1, 2, 2, SIDE, SIDE)
    assert observation[0, 0, 0, 2, 2] == 1  # the robot itself
    assert observation[0, 0, 0, 2, 3] == torch.tensor(-0.2)
    # unknown beside the robot is one step nearer than the robot's own cell
    assert observation[0, 0, 1, 2, 2] == 0
    torch.testing.assert_close(observation[0, 0, 1, 2, 3], torch.tensor(1 / SIDE))
