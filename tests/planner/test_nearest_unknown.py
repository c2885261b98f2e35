"""The batched planner takes the actions that a literal breadth-first search takes."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs.utils import step_mdp

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.planner import nearest_unknown as planner_module
from marl_clean.planner.base import Planner, first_closest, reachable
from marl_clean.planner.nearest_unknown import NearestUnknown
from marl_clean.planner.random import Random
from marl_clean.settings import Assignment, Ties
from marl_clean.world.target_searches import NONE
from tests import reference
from tests.world.play import env_of, start
from tests.world.strategies import Case, cases

STEPS = 12


def follow(case: Case, planner: Planner, compare) -> None:
    """Let the planner play; at each step `compare` before the reference steps."""
    env = env_of([case])
    world = case.world()
    planner.bind(env.base_env)
    tensordict = start(env, [case])
    for _ in range(STEPS):
        tensordict = planner(tensordict)
        actions = tensordict[keys.ACTION][0].tolist()
        compare(planner, world, actions)
        tensordict = env.step(tensordict)
        outcome = world.step(actions)
        if outcome.terminated or outcome.truncated:
            break
        tensordict = step_mdp(tensordict)


@pytest.mark.slow
@given(case=cases(max_agents=4), assignment=st.sampled_from([Assignment.NONE, Assignment.GREEDY]))
@hypothesis_settings(max_examples=20, deadline=None)
def test_actions_are_those_of_breadth_first_search(case: Case, assignment: Assignment) -> None:
    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        for action, expected in zip(
            actions, reference.nearest_unknown(world, assignment), strict=True
        ):
            assert expected is None or action == expected

    follow(case, NearestUnknown(assignment), compare)


@pytest.mark.long
@given(case=cases(max_agents=3))
@hypothesis_settings(max_examples=20, deadline=None)
def test_hungarian_targets_cost_what_the_best_assignment_costs(case: Case) -> None:
    """Of several best assignments SciPy may take another, so the sum of ways is compared."""

    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        best = reference.assigned(world, Assignment.HUNGARIAN)
        left_out, steps = reference.assignment_cost(world, best)
        if left_out == 0:
            assert int((planner.distances(planner.rank())[0].amin(-1) + 1).sum()) == steps

    follow(case, NearestUnknown(Assignment.HUNGARIAN), compare)


@pytest.mark.long
@given(
    case=cases(max_agents=4),
    assignment=st.sampled_from([Assignment.NONE, Assignment.GREEDY]),
    ties=st.sampled_from([Ties.STRAIGHT, Ties.ROTATED]),
)
@hypothesis_settings(max_examples=20, deadline=None)
def test_ties_are_broken_in_the_robots_own_order(
    case: Case, assignment: Assignment, ties: Ties
) -> None:
    places, headings = list(case.starts), [-1] * len(case.starts)

    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        orders = []
        for robot, place in enumerate(world.positions):
            if place != places[robot]:
                headings[robot] = reference.neighbours(places[robot]).index(place)
                places[robot] = place
            fixed = [(robot + shift) % 4 if ties is Ties.ROTATED else shift for shift in range(4)]
            first = headings[robot] if ties is Ties.STRAIGHT else -1
            orders.append(sorted(fixed, key=lambda action: action != first))
        expected = reference.nearest_unknown(world, assignment, orders)
        for action, wanted in zip(actions, expected, strict=True):
            assert wanted is None or action == wanted

    follow(case, NearestUnknown(assignment, ties), compare)


def likely_walls(known: reference.Map) -> set[reference.Place]:
    """Unknown cells with two cells of known wall in line on either side."""
    walls = {place for place, record in known.items() if record.blocked}
    beside = {place for wall in walls for place in reference.neighbours(wall)} - set(known)
    return {
        (row, col)
        for row, col in beside
        if {(row - 2, col), (row - 1, col), (row + 1, col), (row + 2, col)} <= walls
        or {(row, col - 2), (row, col - 1), (row, col + 1), (row, col + 2)} <= walls
    }


@pytest.mark.long
@given(case=cases(max_agents=3))
@hypothesis_settings(max_examples=20, deadline=None)
def test_what_is_probably_wall_comes_after_all_that_is_not(case: Case) -> None:
    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        plain = reference.nearest_unknown(world)
        for robot, action in enumerate(actions):
            known = world.map_of(robot)
            reached = reference.search(world, robot, closed=likely_walls(known))
            unknown = [p for p in reached if p not in known or known[p].spilt]
            wanted = reached[unknown[0]][1] if unknown else plain[robot]
            assert wanted is None or action == wanted

    follow(case, NearestUnknown(wall_prior=True), compare)


def test_a_gap_between_two_pieces_of_wall_is_probably_wall() -> None:
    walls = torch.zeros((1, 1, 5, 7), dtype=torch.bool)
    walls[0, 0, 1, [0, 1, 3, 4]] = True
    assert planner_module.likely_walls(walls).nonzero()[:, 2:].tolist() == [[1, 2]]
    upright = walls.transpose(2, 3)
    assert planner_module.likely_walls(upright).nonzero()[:, 2:].tolist() == [[2, 1]]
    walls[0, 0, 1, 0] = False  # one cell on that side is not enough
    assert not planner_module.likely_walls(walls).any()


@pytest.mark.slow
def test_random_draws_each_robot_its_own_actions() -> None:
    env = env_of([_corridor()] * 64)
    planner = Random().bind(env.base_env)
    tensordict = env.reset()
    drawn = []
    for _ in range(20):
        tensordict = planner(tensordict)
        drawn.append(tensordict[keys.ACTION].clone())
        tensordict = step_mdp(env.step(tensordict))
    actions = torch.stack(drawn)
    shares = torch.bincount(actions.flatten(), minlength=4) / actions.numel()
    assert ((shares - 0.25).abs() < 0.05).all()
    assert (actions[..., 0] != actions[..., 1]).float().mean() > 0.6  # independent: 3 in 4
    assert not torch.equal(actions[0], actions[1])


def _corridor() -> Case:
    return Case(
        free=[[True] * 9],
        furniture=[[0] * 9],
        starts=[(0, 0), (0, 5)],
        settings=reference.Settings(),
        moves=[],
        memorised=None,
        actions=[],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("assignment", "ties", "memory"),
    [
        (Assignment.NONE, Ties.ROTATED, "private"),
        (Assignment.GREEDY, Ties.FIXED, "private"),
        (Assignment.GREEDY, Ties.STRAIGHT, "shared"),
    ],
)
def test_searches_and_floods_take_the_same_actions(
    assignment: Assignment, ties: Ties, memory: str
) -> None:
    """On a CPU robots search outwards, elsewhere they follow a flood from all targets."""
    settings = ["env.n_agents=4", "house.rows=[9,14]", "house.cols=[6,11]", f"env.memory={memory}"]
    env = build.make_env(
        compose_config([*settings, "env.decay_steps=20", "train_houses=8"]), num_envs=8
    )
    planner = NearestUnknown(assignment, ties).bind(env.base_env)
    tensordict = env.reset()
    without = 0
    for _ in range(40):
        tensordict = planner(tensordict)
        rank = planner.rank()
        searched, distances = planner.searched(rank), planner.distances(rank)
        idle = ~reachable(distances)[..., 0]
        assert torch.equal(searched == NONE, idle)
        assert torch.equal(searched[~idle], first_closest(distances, rank)[~idle])
        without += int(idle.sum())
        _, tensordict = env.step_and_maybe_reset(tensordict)
    assert without < 40 * 8 * 4 / 10
