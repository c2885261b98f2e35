"""Every level of the room with every encoder, and the sizes of what is seen."""

from functools import cache

import pytest

from marl_clean import keys
from marl_clean.build import make_agent, make_env
from marl_clean.config.class_source import constant, parameters
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import encoders_of
from marl_clean.config.levels import read_level, rooms
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.rooms import Rooms
from tests.families import family

LEVELS = rooms()["observation"]
HOUSES = draw_houses(Rooms([5, 9], [5, 9]), range(20), n_agents=3)


def settings_of(level: str) -> list[str]:
    """The level, small, with noise where it knows any."""
    target = read_level("observation", level)["_target_"]
    values = {"view_size": 5, "scales": 2, "position_noise": 0.3}
    known = parameters(target)
    small = [f"observation.{key}={value}" for key, value in values.items() if key in known]
    encoder = encoders_of(constant(target, "gives"))[0]
    return [f"observation={level}", f"encoder={encoder}", "topology.view_size=5", *small]


def env_of(level: str, *overrides: str, houses=HOUSES, num_envs: int = 6, **changes):
    config = compose_config([*settings_of(level), "env.n_agents=3", *overrides])
    return make_env(config, houses, num_envs=num_envs, **changes)


@cache
def level_pairs() -> list[tuple[str, str]]:
    return [(level, encoder) for level in LEVELS for encoder in rooms()["encoder"]]


@family(("level", "encoder"), level_pairs(), fast=4)
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


@family("side", [1, 61], fast=[61])
@pytest.mark.parametrize("level", ["crop", "frontier", "pyramid"])
def test_a_square_of_any_odd_side(level: str, side: int) -> None:
    env = env_of(level, f"observation.view_size={side}", "env.memory=private", num_envs=2)
    seen = env.rollout(3)["next", keys.OBSERVATION]
    assert seen.shape[-2:] == (side, side)
    assert env.observation_spec[keys.OBSERVATION].is_in(seen[:, -1])


@pytest.mark.slow
def test_wide_views_do_not_make_the_worlds_wide() -> None:
    assert env_of("pyramid", "observation.view_size=31").base_env.rules.margin == 2
    assert env_of("distances").base_env.rules.margin == 1


def test_a_global_map_refuses_a_larger_house_before_an_episode() -> None:
    with pytest.raises(BadInput, match="largest_side=8: too small for houses of 9x9; at least 9"):
        env_of("global_map", "observation.largest_side=8").reset()


def test_vectors_are_not_rotated() -> None:
    config = compose_config([*settings_of("distances"), "agent.augment=true", "env.n_agents=3"])
    with pytest.raises(BadInput, match=r"agent\.augment=true: rotates squares"):
        make_agent(config, make_env(config, HOUSES, num_envs=2))
