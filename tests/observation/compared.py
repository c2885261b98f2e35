"""What a transform reads from the worlds, compared with what the plain worlds hold."""

from collections.abc import Callable

import torch
from tensordict.utils import NestedKey
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.env.transform import WorldTransform
from tests.reference import World
from tests.world.play import env_of, start, topology_of
from tests.world.strategies import Case

STEPS = 6
Expected = Callable[[World, int, int], list]


def assert_sees(
    drawn: list[Case],
    observation: WorldTransform,
    expected: Expected,
    key: NestedKey = keys.OBSERVATION,
) -> None:
    """Play all cases in one env; in each of its worlds each robot has what is expected of it."""
    env = env_of(drawn)
    env = TransformedEnv(env.base_env, Compose(topology_of(drawn[0].settings), observation))
    worlds = [case.world(index) for index, case in enumerate(drawn)]
    playing = [True] * len(drawn)
    tensordict = start(env, drawn)
    for step in range(min(STEPS, *(len(case.actions) for case in drawn))):
        seen = tensordict[key]
        assert env.observation_spec[key].is_in(seen)
        for index, world in enumerate(worlds):
            if playing[index]:
                robots = range(world.n_agents)
                shown = torch.tensor([expected(world, robot, index) for robot in robots])
                torch.testing.assert_close(seen[index], shown, atol=1e-6, rtol=0)
        actions = [case.actions[step] for case in drawn]
        tensordict[keys.ACTION] = torch.tensor(actions)
        tensordict = step_mdp(env.step(tensordict))
        for index, world in enumerate(worlds):
            if playing[index]:
                outcome = world.step(actions[index])
                playing[index] = not (outcome.terminated or outcome.truncated)
