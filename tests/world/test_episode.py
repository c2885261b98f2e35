"""What is drawn at the start of an episode: uniform, distinct, and of no other world."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import chisquare

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.house.base import draw_houses
from marl_clean.house.drawn import Drawn
from marl_clean.house.rooms import Rooms
from marl_clean.settings import HouseOrder, Knowledge
from marl_clean.world.distance import is_connected
from marl_clean.world.random import Purpose, random_below, random_bits, seed_tensor
from marl_clean.world.rules import Rules
from tests.world.play import houses_of

ENOUGH = 1e-3  # a fair draw falls below this p once in a thousand; the draws are fixed


def test_draws_are_uniform_and_streams_differ() -> None:
    env = torch.arange(20_000)
    for words in ((0, env), (1, env), (0, env, 5, Purpose.ACTION), (2**40 + 3, env, 5)):
        counts = torch.bincount(random_below(7, *words), minlength=7)
        assert chisquare(counts.numpy()).pvalue > ENOUGH
    first = random_bits(0, env, 0, Purpose.HOUSE)
    for other in (
        random_bits(1, env, 0, Purpose.HOUSE),
        random_bits(2**32, env, 0, Purpose.HOUSE),  # the seed's high word counts too
        random_bits(0, env, 1, Purpose.HOUSE),
        random_bits(0, env, 0, Purpose.START),
    ):
        assert (first == other).float().mean() < 1e-3
        correlation = torch.corrcoef(torch.stack([first, other]).double())[0, 1]
        assert abs(correlation) < 0.03


@pytest.mark.parametrize("seed", [0, 1, 2**32 + 7, 2**63, 2**63 + 5, 2**64 - 1, -3])
def test_a_seed_as_a_tensor_draws_the_same(seed: int) -> None:
    env = torch.arange(50)
    as_tensor = seed_tensor(seed, env.device)
    assert as_tensor.dtype == torch.int64
    assert torch.equal(random_bits(as_tensor, env, 3), random_bits(seed, env, 3))
    assert torch.equal(random_below(7, as_tensor, env), random_below(7, seed, env))


def test_draws_keep_their_values() -> None:
    """Published results hang on these numbers: a change of them is a new world version."""
    assert random_bits(0, torch.tensor([0, 1, 2]), 3).tolist() == FIRST_DRAWS


FIRST_DRAWS = [1408362973, 3831518755, 1366117550]


def test_starts_are_uniform_over_the_free_cells_and_distinct() -> None:
    free = [[True, False, True, True], [True, True, True, False]]
    env = CleaningEnv(houses_of(free, None, [(-1, -1)] * 2), n_agents=2, num_envs=12_000)
    position = env.state.position
    assert (position[:, 0] != position[:, 1]).any(-1).all()
    cells = position[..., 0] * 4 + position[..., 1]
    counts = torch.bincount(cells.flatten(), minlength=8)
    blocked = torch.tensor(free).flatten().logical_not()
    assert not counts[blocked].any()
    assert chisquare(counts[~blocked].numpy()).pvalue > ENOUGH
    pairs = torch.bincount(cells[:, 0] * 8 + cells[:, 1], minlength=64)
    assert chisquare(pairs[pairs > 0].numpy()).pvalue > ENOUGH and (pairs > 0).sum() == 6 * 5


def test_a_plans_own_starts_are_kept_and_the_rest_drawn() -> None:
    houses = houses_of([[True] * 5] * 3, None, [(2, 3)])
    env = CleaningEnv(houses, n_agents=3, num_envs=50)
    assert (env.state.position[:, 0] == torch.tensor([2, 3])).all()
    assert len({tuple(place) for place in env.state.position[:, 1].tolist()}) > 5


def test_every_house_of_a_bank_is_drawn() -> None:
    houses = draw_houses(Rooms([7, 7], [7, 7]), range(16), n_agents=2)
    env = CleaningEnv(houses, num_envs=8_000)
    counts = torch.bincount(env.state.house, minlength=16)
    assert chisquare(counts.numpy()).pvalue > ENOUGH


def test_stale_robots_remember_the_house_before_the_furniture_moved() -> None:
    houses = draw_houses(Drawn("apartment"), [0], n_agents=2)
    env = CleaningEnv(
        houses,
        Rules(knowledge=Knowledge.STALE),
        num_envs=40,
        furniture_moves_before_start=12,
        house_order=HouseOrder.FIXED,
    )
    margin, state = env.rules.margin, env.state
    inner = slice(margin, -margin)
    before = torch.from_numpy(houses.free)
    now = ~state.blocked[:, inner, inner]
    believed = state.record[:, 0, inner, inner] > 0
    rows, cols = np.nonzero(houses.furniture[0])
    assert (now != before).any((1, 2)).float().mean() > 0.9  # something moved in almost all
    assert torch.equal(now.sum((1, 2)), before.sum((1, 2)).expand(40))  # pieces keep their size
    assert is_connected(now).all()
    start = torch.zeros_like(believed)
    env_index = torch.arange(40)[:, None]
    start[env_index, state.position[..., 0], state.position[..., 1]] = True
    assert torch.equal(believed | start, before.expand(40, -1, -1) | start)
    walls = ~before[0].clone()
    walls[rows, cols] = False
    assert not now[:, walls].any()  # only furniture moves


def test_starts_do_not_depend_on_what_is_stored_around_a_house() -> None:
    """Neither the view's margin nor a larger house in the same stack may move a robot."""
    small = draw_houses(Rooms([7, 7], [7, 7]), range(3), n_agents=2)
    padded = draw_houses(Rooms([7, 7], [7, 7]), range(3), n_agents=2)
    wider = {
        name: np.pad(getattr(padded, name), ((0, 0), (0, 5), (0, 9)))
        for name in ("free", "furniture")
    }
    envs = [
        CleaningEnv(small, num_envs=3, house_order=HouseOrder.FIXED),
        CleaningEnv(small, Rules(margin=2), num_envs=3, house_order=HouseOrder.FIXED),
        CleaningEnv(replace(padded, **wider), num_envs=3, house_order=HouseOrder.FIXED),
    ]
    for env in envs[1:]:
        assert torch.equal(env.state.position, envs[0].state.position)


def test_stale_furniture_never_stands_on_a_plans_own_starts() -> None:
    furniture = [[0] * 6 for _ in range(5)]
    furniture[2][2] = furniture[2][3] = 1
    free = [[piece == 0 for piece in row] for row in furniture]
    env = CleaningEnv(
        houses_of(free, furniture, [(2, 1), (1, 2)]),
        Rules(knowledge=Knowledge.STALE),
        num_envs=64,
        furniture_moves_before_start=6,
    )
    margin, position = env.rules.margin, env.state.position + env.rules.margin
    blocked = env.state.blocked[torch.arange(64)[:, None], position[..., 0], position[..., 1]]
    assert not blocked.any()
    assert (env.state.position == torch.tensor([(2, 1), (1, 2)])).all()
    assert (env.state.blocked[:, margin + 2, margin + 2] == 0).any()  # it did move
