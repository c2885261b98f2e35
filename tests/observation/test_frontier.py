"""The frontier plane is what a plain search over the robots' map gives."""

from collections import deque

import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.observation.frontier import Frontier
from tests import reference
from tests.world.play import env_of, start, topology_of
from tests.world.strategies import Case, cases

SIDE = 5
STEPS = 8


def steps_to_frontier(world: reference.World, robot: int) -> dict[reference.Place, int]:
    """Walking distances to the nearest unknown or dirty cell, over cells known to be free."""
    known = world.map_of(robot)
    matrix = [(r, c) for r in range(-1, world.rows + 1) for c in range(-1, world.cols + 1)]
    free = {place for place in matrix if place in known and not known[place].blocked}

    def is_goal(place: reference.Place) -> bool:
        record = known.get(place)
        return record is None or reference.value(record, world.steps, world.settings) == 0

    found = {place: 0 for place in matrix if is_goal(place)}
    queue = deque(found)
    while queue:
        row, col = queue.popleft()
        for near in ((row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)):
            if near in free and near not in found:
                found[near] = found[row, col] + 1
                queue.append(near)
    return found


def expected_plane(world: reference.World, robot: int) -> torch.Tensor:
    distance = steps_to_frontier(world, robot)
    row, col = world.positions[robot]
    plane = torch.zeros(SIDE, SIDE)
    if (row, col) not in distance:
        return plane
    own = distance[row, col]
    for r in range(SIDE):
        for c in range(SIDE):
            place = (row + r - SIDE // 2, col + c - SIDE // 2)
            if not world.in_matrix(place):
                continue  # compared inside the matrix only
            nearer = (own - distance[place]) / SIDE if place in distance else -1.0
            plane[r, c] = min(1.0, max(-1.0, nearer))
    return plane


@given(case=cases(max_agents=3))
@hypothesis_settings(max_examples=40, deadline=None)
def test_the_plane_is_a_plain_searchs(case: Case) -> None:
    base = env_of([case]).base_env
    env = TransformedEnv(base, Compose(topology_of(case.settings), Frontier(SIDE)))
    world = case.world()
    tensordict = start(env, [case])
    for actions in case.actions[:STEPS]:
        plane = tensordict[keys.OBSERVATION][0, :, 1]
        for robot, (row, col) in enumerate(world.positions):
            reach = range(-(SIDE // 2), SIDE // 2 + 1)
            inside = torch.tensor(
                [[world.in_matrix((row + r, col + c)) for c in reach] for r in reach]
            )
            expected = expected_plane(world, robot)
            torch.testing.assert_close(plane[robot][inside], expected[inside], atol=1e-6, rtol=0)
        tensordict[keys.ACTION] = torch.tensor([actions])
        tensordict = step_mdp(env.step(tensordict))
        outcome = world.step(actions)
        if outcome.terminated or outcome.truncated:
            break


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
