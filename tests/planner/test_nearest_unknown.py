"""The batched planner takes the actions that a literal breadth-first search takes."""

import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.planner.nearest_unknown import NearestUnknown
from marl_clean.planner.random import Random
from marl_clean.settings import Assignment
from tests import reference
from tests.world.play import env_of, start
from tests.world.strategies import Case, cases

STEPS = 12


def follow(case: Case, assignment: Assignment, compare) -> None:
    """Let the planner play; at each step `compare` before the reference steps."""
    env = env_of([case])
    world = case.world()
    planner = NearestUnknown(assignment).bind(env.base_env)
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


@given(case=cases(max_agents=4), assignment=st.sampled_from([Assignment.NONE, Assignment.GREEDY]))
@hypothesis_settings(max_examples=60, deadline=None)
def test_actions_are_those_of_breadth_first_search(case: Case, assignment: Assignment) -> None:
    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        for action, expected in zip(
            actions, reference.nearest_unknown(world, assignment), strict=True
        ):
            assert expected is None or action == expected

    follow(case, assignment, compare)


@given(case=cases(max_agents=3))
@hypothesis_settings(max_examples=40, deadline=None)
def test_hungarian_targets_cost_what_the_best_assignment_costs(case: Case) -> None:
    """Of several best assignments SciPy may take another, so the sum of ways is compared."""

    def compare(planner: NearestUnknown, world: reference.World, actions: list[int]) -> None:
        best = reference.assigned(world, Assignment.HUNGARIAN)
        left_out, steps = reference.assignment_cost(world, best)
        if left_out == 0:
            assert int((planner.distances(planner.rank())[0].amin(-1) + 1).sum()) == steps

    follow(case, Assignment.HUNGARIAN, compare)


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
