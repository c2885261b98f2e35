"""Bumps that nobody notices, and robots that mistake their place: how often, and what follows."""

import pytest
import torch

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.world.noise import believed_position, unnoticed_bumps
from marl_clean.world.random import Purpose, random_bits
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_known_blocked
from tests.world.play import houses_of
from tests.world.strategies import BUMP, missed_bumps, plain_bits

UP = 0


def lane(num_envs: int = 1, **changes) -> CleaningEnv:
    houses = houses_of([[True] * 5], None, [(0, 2)])
    env = CleaningEnv(houses, Rules(**changes), n_agents=1, num_envs=num_envs)
    env.reset()
    return env


def bump(env: CleaningEnv) -> torch.Tensor:
    action = torch.full((env.num_envs, 1), UP)
    return env.step(env.rand_action().set(("agents", "action"), action))["next"]


def test_plain_integers_hash_as_tensors_do() -> None:
    words = [3, 12, BUMP, 40, 1]
    for seed in (0, 2**40 + 3):
        drawn = random_bits(seed, *(torch.tensor(word) for word in words))
        assert int(drawn) == plain_bits(seed, *words)
    assert Purpose.BUMP == BUMP


def test_an_unnoticed_bump_is_counted_and_neither_written_nor_paid() -> None:
    env = lane(bump_noise=1.0)
    for _ in range(3):
        step = bump(env)
        assert env.state.bumped.all()
        assert step["agents", "own_reward"].flatten().tolist() == [-1]
    assert not is_known_blocked(env.state.record).any()
    assert bump(lane(bump_noise=0.0))["agents", "own_reward"].item() == 1


@pytest.mark.slow
def test_as_many_bumps_are_missed_as_the_setting_says() -> None:
    env = lane(num_envs=20_000, bump_noise=0.3)
    missed = unnoticed_bumps(env.state, env.env_index, 0, 0.3)
    assert missed.float().mean().item() == pytest.approx(0.3, abs=0.015)
    bump(env)
    assert torch.equal(missed.flatten(), ~is_known_blocked(env.state.record).flatten(1).any(1))
    assert [(0, 0) in missed_bumps(0.3, index, 1) for index in range(50)] == missed[:50, 0].tolist()


def test_a_robot_mistakes_its_place_as_often_as_the_setting_says_and_evenly() -> None:
    env = CleaningEnv(houses_of([[True] * 3] * 3, None, [(1, 1)]), n_agents=1, num_envs=20_000)
    place = believed_position(env.state, env.env_index, 0, 0.4)[:, 0]
    cells = torch.bincount(place[:, 0] * 3 + place[:, 1], minlength=9) / 20_000
    expected = torch.tensor([0, 0.1, 0, 0.1, 0.6, 0.1, 0, 0.1, 0])
    torch.testing.assert_close(cells, expected, atol=0.015, rtol=0)


def test_nobody_thinks_that_it_is_outside_its_house() -> None:
    env = lane(num_envs=500)
    place = believed_position(env.state, env.env_index, 0, 1.0)[:, 0]
    assert set(map(tuple, place.tolist())) == {(0, 1), (0, 2), (0, 3)}


def test_without_noise_nothing_is_drawn() -> None:
    env = lane(num_envs=50)
    assert torch.equal(believed_position(env.state, env.env_index, 0, 0.0), env.state.position)
