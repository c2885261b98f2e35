"""What every level of the room keeps, by the listing of `conf/observation`."""

from functools import cache

import pytest
import torch
from torchrl.envs import check_env_specs

from marl_clean import keys
from marl_clean.build import make_agent, make_env
from marl_clean.config.class_source import constant, parameters
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import encoders_of
from marl_clean.config.levels import rooms
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.open import Open
from marl_clean.house.rooms import Rooms

LEVELS = rooms()["observation"]
HOUSES = draw_houses(Rooms([5, 9], [5, 9]), range(20), n_agents=3)
LANES = draw_houses(Open([1, 1], [6, 6]), [0], n_agents=3)
MEMORIES = ["shared", "private", "merged"]


def settings_of(level: str) -> list[str]:
    """The level, small, with noise where it knows any."""
    config = compose_config([f"observation={level}"])
    values = {"view_size": 5, "scales": 2, "position_noise": 0.3}
    known = parameters(config.observation._target_)
    small = [f"observation.{key}={value}" for key, value in values.items() if key in known]
    encoder = encoders_of(constant(config.observation._target_, "gives"))[0]
    return [f"observation={level}", f"encoder={encoder}", "topology.view_size=5", *small]


def env_of(level: str, *overrides: str, houses=HOUSES, num_envs: int = 6, **changes):
    config = compose_config([*settings_of(level), "env.n_agents=3", *overrides])
    return make_env(config, houses, num_envs=num_envs, **changes)


def play(env, actions: torch.Tensor) -> list:
    tensordict = env.reset()
    steps = []
    for action in actions:
        tensordict[keys.ACTION] = action
        step, tensordict = env.step_and_maybe_reset(tensordict)
        steps.append(step["next"].clone())
    return steps


def actions_for(steps: int, num_envs: int) -> torch.Tensor:
    return torch.randint(0, 4, (steps, num_envs, 3), generator=torch.Generator().manual_seed(7))


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("level", LEVELS)
def test_values_are_within_the_spec(level: str, memory: str) -> None:
    env = env_of(level, f"env.memory={memory}", "env.sensor=touch4", "env.bump_noise=0.2")
    check_env_specs(env, check_dtype=True)
    rollout = env.rollout(20, break_when_any_done=False)
    spec = env.observation_spec[keys.OBSERVATION]
    for step in range(20):
        assert spec.is_in(rollout[keys.OBSERVATION][:, step])
        assert spec.is_in(rollout["next", keys.OBSERVATION][:, step])


@pytest.mark.parametrize("level", LEVELS)
def test_a_lane_of_one_row_is_a_house(level: str) -> None:
    env = env_of(level, houses=LANES, num_envs=2)
    seen = env.rollout(8)["next", keys.OBSERVATION]
    assert seen.isfinite().all()


@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("level", LEVELS)
def test_env_i_of_many_sees_what_env_i_sees_alone(level: str, memory: str) -> None:
    overrides = [f"env.memory={memory}", "env.stuck_after=4", "env.bump_noise=0.3"]
    actions = actions_for(40, 4)
    together = torch.stack(play(env_of(level, *overrides, num_envs=4), actions))
    assert together[keys.DONE][:, 2].any()  # it starts anew, too
    alone = env_of(level, *overrides, num_envs=1, first_env=2)
    steps = torch.stack(play(alone, actions[:, 2:3]))
    for key in (keys.OBSERVATION, keys.REWARD, keys.DONE):
        torch.testing.assert_close(steps[key][:, 0], together[key][:, 2], atol=1e-6, rtol=0)


@pytest.mark.parametrize("level", LEVELS)
def test_a_partial_reset_shows_what_a_whole_computation_does(level: str) -> None:
    env = env_of(level, "env.memory=private", num_envs=5)
    last = play(env, actions_for(6, 5))[-1].select(keys.AGENTS, *keys.ENDINGS)
    last["_reset"] = torch.tensor([False, True, False, False, True])[:, None]
    after = env.reset(last)
    whole = env.transform[1].read(env.base_env.state, env.base_env.setup)
    torch.testing.assert_close(after[keys.OBSERVATION], whole[keys.OBSERVATION], atol=1e-6, rtol=0)


@cache
def level_pairs() -> list[tuple[str, str]]:
    return [(level, encoder) for level in LEVELS for encoder in rooms()["encoder"]]


@pytest.mark.parametrize(("level", "encoder"), level_pairs())
def test_a_pair_builds_a_network_or_is_refused_in_a_line(level: str, encoder: str) -> None:
    config = compose_config([f"observation={level}", f"encoder={encoder}", "env.n_agents=3"])
    env = make_env(config, HOUSES, num_envs=2)
    if encoder not in encoders_of(env.transform[1].gives):
        with pytest.raises(BadInput, match=f"encoder={encoder}: takes .*; valid: ") as caught:
            make_agent(config, env)
        assert "\n" not in str(caught.value)
        return
    action = make_agent(config, env).policy()(env.reset())[keys.ACTION]
    assert action.shape == (2, 3)


@pytest.mark.parametrize("side", [1, 61])
@pytest.mark.parametrize("level", ["crop", "frontier", "pyramid"])
def test_a_square_of_any_odd_side(level: str, side: int) -> None:
    env = env_of(level, f"observation.view_size={side}", "env.memory=private", num_envs=2)
    seen = env.rollout(3)["next", keys.OBSERVATION]
    assert seen.shape[-2:] == (side, side)
    assert env.observation_spec[keys.OBSERVATION].is_in(seen[:, -1])


def test_wide_views_do_not_make_the_worlds_wide() -> None:
    assert env_of("pyramid", "observation.view_size=31").base_env.rules.margin == 2
    assert env_of("distances").base_env.rules.margin == 1


def test_a_global_map_refuses_a_larger_house_before_it_is_played() -> None:
    with pytest.raises(BadInput, match="largest_side=8: too small for houses of 9x9; at least 9"):
        env_of("global_map", "observation.largest_side=8").reset()


def test_what_is_no_square_is_not_turned() -> None:
    config = compose_config([*settings_of("distances"), "agent.augment=true", "env.n_agents=3"])
    with pytest.raises(BadInput, match=r"agent\.augment=true: turns squares"):
        make_agent(config, make_env(config, HOUSES, num_envs=2))
