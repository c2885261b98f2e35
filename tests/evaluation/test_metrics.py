"""The measures equal those of the plain world, and say what they should of episodes by hand."""

import math
from dataclasses import fields

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.evaluation.metrics import Recorder
from marl_clean.house.base import Houses
from marl_clean.keys import ACTION, ADJACENCY, MESSAGE_BITS, MESSAGE_EDGES
from marl_clean.settings import HouseOrder, Memory, Spills
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import in_view
from tests import reference
from tests.families import family
from tests.world.strategies import spills

UP, RIGHT, DOWN, LEFT = range(4)
VIEW = 7


def houses_of(*pictures: str, starts: list[list[tuple[int, int]]] | None = None) -> Houses:
    """Drawn houses of any sizes, `.` free, `#` blocked, digits pieces of furniture."""
    drawn = [picture.split() for picture in pictures]
    size = len(drawn), max(map(len, drawn)), max(len(house[0]) for house in drawn)
    free, furniture = np.zeros(size, dtype=bool), np.zeros(size, dtype=np.int16)
    for index, house in enumerate(drawn):
        for place in np.ndindex(len(house), len(house[0])):
            mark = house[place[0]][place[1]]
            free[(index, *place)] = mark == "."
            furniture[(index, *place)] = int(mark) if mark.isdigit() else 0
    return Houses(
        free=free,
        furniture=furniture,
        rows=np.array([len(house) for house in drawn]),
        cols=np.array([len(house[0]) for house in drawn]),
        starts=None if starts is None else np.array(starts),
        sources=list(pictures),
    )


def env_of(houses: Houses, **settings) -> CleaningEnv:
    names = {field.name for field in fields(Rules)}
    rules = {name: settings.pop(name) for name in names & settings.keys()}
    defaults = {"num_envs": len(houses), "house_order": HouseOrder.FIXED}
    return CleaningEnv(houses, Rules(**{"stuck_after": None, **rules}), **{**defaults, **settings})


def played(env: CleaningEnv, actions, certify: bool = False, bits: int = 0) -> Recorder:
    """The recorder of an episode: `actions(step)` gives [env, robot]; plays until all are done."""
    env.reset()
    recorder = Recorder(env, certify)
    step = 0
    while recorder.running.any():
        td = TensorDict(batch_size=env.batch_size)
        td[ADJACENCY] = in_view(env.state.position, VIEW)
        if bits:
            td[MESSAGE_BITS] = td[ADJACENCY].sum(-1, keepdim=True) * float(bits)
        td[ACTION] = torch.as_tensor(actions(step))
        td["next"] = env.step(td.clone())["next"]
        recorder.update(td)
        step += 1
    return recorder


HOUSES = ("....... ..#.... .......", "... .#. ... ..# ... .#. ...", ".....", "#.# ... #.#")


MEASURED = [
    (n_agents, True, memory, spilling)
    for n_agents in (1, 3)
    for memory in (Memory.SHARED, Memory.PRIVATE)
    for spilling in (0, 3)
]
MEASURED += [(1, False, Memory.PRIVATE, 0), (3, False, Memory.SHARED, 3)]  # T_certify alone lacks


@family(("n_agents", "certify", "memory", "spilling"), MEASURED, fast=MEASURED[8:], usual=2)
def test_random_episodes_are_measured_as_by_the_plain_world(n_agents, certify, memory, spilling):
    env = env_of(
        houses_of(*HOUSES),
        n_agents=n_agents,
        memory=memory,
        spills=Spills(spilling, size=3),
        max_steps=400,  # long enough to become certain in the small ones
        seed=n_agents,
        contact=lambda state: in_view(state.position, VIEW),
    )
    drawn = torch.randint(
        4, (400, len(HOUSES), n_agents), generator=torch.Generator().manual_seed(3)
    )
    env.reset()
    starts = env.state.position.tolist()
    env.set_seed(n_agents)  # the same starts again
    records = played(env, lambda step: drawn[step], certify).records()
    settings = reference.Settings(
        stuck_after=None,
        view_size=VIEW,
        memory=memory,
        max_steps=400,
        spills=spilling,
        spill_size=3,
    )
    for index, picture in enumerate(HOUSES):
        free = [[mark == "." for mark in line] for line in picture.split()]
        drawn_spills = spills(spilling, index, free, n_agents, seed=n_agents)
        world = reference.World(
            free, [tuple(place) for place in starts[index]], settings, spills=drawn_spills
        )
        episode = reference.play(world, drawn[:, index].tolist(), certify)
        expected = reference.measures(episode)
        if not certify:
            del expected["T_certify"]
        for name, value in expected.items():
            assert records[index][name] == pytest.approx(value and float(value)), (index, name)
            assert isinstance(value, int) == isinstance(records[index][name], int), name
        assert records[index]["max_steps"] == world.max_steps
        assert ("spill_delay" in records[index]) == (spilling > 0)
    assert not certify or any(record["T_certify"] for record in records)
    assert not spilling or any(record["spill_delay"] for record in records)


def test_a_corridor_by_hand():
    # Robot 1 walks right from the left end and back once; robot 2 bumps at the right end.
    env = env_of(houses_of(".....", starts=[[(0, 0), (0, 4)]]))
    moves = [(RIGHT, RIGHT), (LEFT, UP), (RIGHT, DOWN), (RIGHT, LEFT)]
    (record,) = played(env, lambda step: [moves[step]], bits=32).records()
    # Cleaned: 2 at once, 3, 3, 3, then robot 1 enters the middle and robot 2 the fourth: 5.
    assert [record[f"T_{q}"] for q in (90, 95, 99, 100)] == [4, 4, 4, 4]
    assert record["bound_100"] == 2 and record["ratio_100"] == 2.0
    assert record["coverage"] == 1.0
    steps = record["max_steps"] + 1
    assert record["max_steps"] == 4 * 5 // 2 + 50
    assert record["coverage_auc"] == pytest.approx((2 + 3 + 3 + 3 + 5 * (steps - 4)) / (5 * steps))
    assert record["redundancy"] == pytest.approx(7 / 5 - 1)  # 2 starts and 5 entries, 5 cells
    assert record["overlap"] == 0.0
    assert record["balance"] == pytest.approx(np.std([3, 2]) / 2.5)
    assert record["bumps"] == 3 and record["collisions"] == 0
    # Before steps 2 and 4 they stand three cells apart, each inside the other's view.
    assert record["contact"] == 0.5 and record["edges"] == 0.5
    assert record["messages"] == 1.0 and record["bits"] == 32.0
    assert record["rounds"] == 0.5 and record["gate"] == 1.0
    assert record["messages_per_cell"] == 4 / 5 and record["bits_per_cell"] == 128 / 5
    assert record["edges_per_cell"] == record["rounds_per_cell"] == 2 / 5
    # New floor pays 3.4, a new wall 1, and a step back into what is clean -1.
    assert record["return"] == pytest.approx((3.4 - 1 - 1 + 3.4) + (1 + 1 + 1 + 3.4), abs=1e-4)


def test_rounds_and_gates_are_counted_from_the_policys_entries():
    env = env_of(houses_of("....", starts=[[(0, 0), (0, 1), (0, 2)]]), n_agents=3, max_steps=2)
    td = TensorDict(batch_size=env.batch_size)
    env.reset()
    recorder = Recorder(env)
    td[ADJACENCY] = torch.tensor(
        [[[False, True, False], [True, False, True], [False, True, False]]]
    )
    td[MESSAGE_EDGES] = torch.tensor([[[1.0, 1.0], [0.0, 0.0], [1.0, 0.0]]])  # robot 2 is silent
    td[MESSAGE_BITS] = torch.tensor([[[20.0], [0.0], [10.0]]])
    td[ACTION] = torch.tensor([[UP, UP, UP]])
    td["next"] = env.step(td.clone())["next"]
    recorder.update(td)
    (record,) = recorder.records()
    assert record["edges"] == 2 and record["messages"] == 3 and record["rounds"] == 2
    assert record["gate"] == 2 / 4 and record["bits"] == 30 and record["bits_per_cell"] == 10


def test_a_silent_policy_costs_nothing_and_has_no_gate():
    env = env_of(houses_of("....", starts=[[(0, 0), (0, 1)]]), max_steps=3)
    (record,) = played(env, lambda step: [[UP, UP]]).records()
    assert record["edges"] == 1.0 and record["messages"] == record["rounds"] == record["bits"] == 0
    assert record["gate"] is None


def test_an_unfinished_house_has_null_times_and_its_last_coverage():
    env = env_of(houses_of("....", starts=[[(0, 0)]]), n_agents=1, max_steps=7)
    (record,) = played(env, lambda step: [[UP]]).records()
    assert record["T_90"] is None and record["T_100"] is None and record["ratio_100"] is None
    assert record["coverage"] == 0.25 and record["coverage_auc"] == pytest.approx(0.25)
    assert record["bumps"] == 7


def test_a_clean_house_is_frozen_while_others_continue():
    two = houses_of("..", "......", starts=[[(0, 0)], [(0, 0)]])
    together = played(env_of(two, n_agents=1), lambda step: [[RIGHT], [RIGHT]]).records()
    alone = played(
        env_of(houses_of("..", starts=[[(0, 0)]]), n_agents=1), lambda step: [[RIGHT]]
    ).records()
    assert together[0]["T_100"] == 1 and together[0]["bumps"] == 0
    ignored = {"cols"}
    assert {k: v for k, v in together[0].items() if k not in ignored} == {
        k: v for k, v in alone[0].items() if k not in ignored
    }


def test_certainty_takes_longer_than_cleaning_and_changes_no_other_measure():
    houses = houses_of("..", starts=[[(0, 0)]])
    walls = [RIGHT, RIGHT, UP, DOWN, LEFT, UP, DOWN, LEFT]
    (sure,) = played(env_of(houses, n_agents=1), lambda step: [[walls[step]]], True).records()
    (plain,) = played(env_of(houses, n_agents=1), lambda step: [[walls[step]]]).records()
    assert sure["T_100"] == 1 and sure["T_certify"] == len(walls)
    assert sure["bound_certify"] == 7  # one cell and six walls
    assert sure["ratio_certify"] == pytest.approx(8 / 7)
    assert {name: sure[name] for name in plain} == plain


@pytest.mark.slow
def test_moving_furniture_is_measured_as_in_the_plain_world_and_has_no_bounds():
    picture = "..... .11.. ....2 .3..."
    env = env_of(houses_of(picture), furniture_moves_per_episode=30, max_steps=150, seed=2)
    drawn = torch.randint(4, (150, 1, 2), generator=torch.Generator().manual_seed(1))
    env.reset()
    starts, moves = env.state.position[0].tolist(), env.state.furniture_moves[0].tolist()
    env.set_seed(2)
    (record,) = played(env, lambda step: drawn[step]).records()
    lines = picture.split()
    world = reference.World(
        [[mark == "." for mark in line] for line in lines],
        [tuple(place) for place in starts],
        reference.Settings(stuck_after=None, view_size=VIEW, max_steps=150),
        [[int(mark) if mark.isdigit() else 0 for mark in line] for line in lines],
        [tuple(move) for move in moves],
    )
    expected = reference.measures(reference.play(world, drawn[:, 0].tolist()))
    del expected["T_certify"]
    assert {name: record[name] for name in expected} == pytest.approx(
        {name: value and float(value) for name, value in expected.items()}
    )
    assert record["bound_100"] is None and record["ratio_90"] is None


def test_no_step_has_no_rate():
    env = env_of(houses_of("..", starts=[[(0, 0)]]), n_agents=1)
    env.reset()
    (record,) = Recorder(env).records()
    assert record["contact"] is None and record["T_90"] is None
    assert math.isclose(record["coverage"], 0.5)
