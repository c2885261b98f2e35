"""The cleaning world through PettingZoo's door: its own tests, and ours for what they leave out."""

import importlib
import sys
from itertools import count
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test
from pettingzoo.utils.conversions import parallel_to_aec
from torchrl.envs.utils import step_mdp

from marl_clean import keys, make_env
from marl_clean.errors import BadInput
from marl_clean.pettingzoo import ParallelCleaning, parallel_env
from marl_clean.world.dynamics import MOVES
from marl_clean.world.shared_map import map_value, union_of_maps
from tests.families import family

pytestmark = pytest.mark.usefixtures("unchecked")

FEW = ["train_houses=6", "house.rows=[6,7]", "house.cols=[5,8]", "env.max_steps=30"]
WORLDS = {
    "default": [],
    "private": ["env.memory=private", "env.n_agents=3", "env.sensor=touch4", "reward=individual"],
    "merged": ["env.memory=merged", "observation=frontier", "reward=team", "env.stuck_after=9"],
    "spills": ["env.spills.per_episode=4", "env.memory=private"],
    "team": ["env.memory=private", "env.knowledge=[memorised,unknown]", "env.collision_pays=-1"],
    "stale": ["env.knowledge=stale", "env.furniture_moves_before_start=3", "topology=none"],
}


def make(*overrides: str, **settings: Any) -> ParallelCleaning:
    return parallel_env([*FEW, *overrides], **settings)


def run_episode(env: ParallelCleaning, seed: int | None, actions_seed: int = 0) -> list[Any]:
    """Everything that one whole episode shows, under random actions."""
    rng = np.random.default_rng(actions_seed)
    seen: list[Any] = [env.reset(seed=seed), env.state()]
    while env.agents:
        actions = {agent: int(rng.integers(len(MOVES))) for agent in env.agents}
        seen += [env.step(actions), env.state()]
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("extras", [{}, {"adjacency": True, "action_masks": True}])
def test_pettingzoo_accepts_the_parallel_env(extras: dict[str, bool]) -> None:
    parallel_api_test(make(**extras), num_cycles=300)


@pytest.mark.filterwarnings("ignore:Observation space for each agent probably:UserWarning")
@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array:UserWarning")  # but a Dict
@pytest.mark.parametrize("extras", [{}, {"adjacency": True, "action_masks": True}])
def test_pettingzoo_accepts_it_agent_by_agent(extras: dict[str, bool]) -> None:
    api_test(parallel_to_aec(make(**extras)), num_cycles=100)


@pytest.mark.slow
def test_pettingzoo_finds_it_seeded() -> None:
    parallel_seed_test(make)


@pytest.mark.slow
def test_pettingzoo_accepts_its_pictures(capsys: pytest.CaptureFixture[str]) -> None:
    render_test(lambda render_mode: parallel_to_aec(make(render_mode=render_mode)))


@pytest.mark.slow
def test_a_whole_episode_repeats_under_its_seed_and_not_under_another() -> None:
    # Without a limit that random actions could reach: 300 steps, however they go.
    large = ["house.rows=[14,14]", "house.cols=[14,14]", "env.stuck_after=null"]
    env = make(*large, "env.max_steps=300")
    first = run_episode(env, seed=3)
    assert len(first) == 2 + 2 * 300
    assert data_equivalence(
        first, run_episode(make(*large, "env.max_steps=300"), seed=3), exact=True
    )
    assert not data_equivalence(first[0], env.reset(seed=4))


@pytest.mark.slow
@pytest.mark.parametrize("overrides", WORLDS.values(), ids=WORLDS)
def test_it_steps_as_the_batched_env_does(overrides: list[str]) -> None:
    env = make(*overrides, adjacency=True)
    batched = make_env([*FEW, *overrides, "env.num_envs=1"])
    batched.set_seed(5)
    seed: int | None = 5
    rng = np.random.default_rng(0)
    for _ in range(2):  # the second reset begins the next episode of the same seed
        seen, infos = env.reset(seed=seed)
        td = batched.reset()
        seed = None
        assert set(infos) == set(env.possible_agents)
        for step in count():
            for index, agent in enumerate(env.agents):
                assert (seen[agent]["observation"] == td[keys.OBSERVATION][0, index].numpy()).all()
                assert (seen[agent]["adjacency"] == td[keys.ADJACENCY][0, index].numpy()).all()
                assert env.observation_space(agent).contains(seen[agent])
            action = rng.integers(len(MOVES), size=len(env.agents))
            td[keys.ACTION] = torch.from_numpy(action)[None]
            later = batched.step(td)["next"]
            agents = list(env.agents)
            seen, reward, terminated, truncated, infos = env.step(
                dict(zip(agents, action, strict=True))
            )
            for index, agent in enumerate(agents):
                assert reward[agent] == later[keys.REWARD][0, index, 0]
                assert terminated[agent] == later[keys.TERMINATED][0, 0]
                assert truncated[agent] == later[keys.TRUNCATED][0, 0]
                terms = later[keys.AGENTS, "info"][0, index].to_dict()
                further = {"spill"} if env.world.rules.spills.per_episode else set()
                further |= {"collision"} if env.world.rules.collision_pays else set()
                assert set(terms) == {"step", "cleaning", "discovery", *further}
                assert infos[agent] == {**terms, "own_reward": later[keys.OWN_REWARD][0, index, 0]}
            td = step_mdp(td)
            if later[keys.DONE]:
                assert env.agents == []
                break
            assert env.agents == agents
            assert step < 1000


@pytest.mark.parametrize("overrides", WORLDS.values(), ids=WORLDS)
def test_a_mask_closes_what_the_robots_own_map_holds_for_blocked(overrides: list[str]) -> None:
    env = make(*overrides, action_masks=True)
    seen, _ = env.reset(seed=1)
    rng = np.random.default_rng(1)
    closed = 0
    while env.agents:
        state, margin = env.world.state, env.world.rules.margin
        for index, agent in enumerate(env.agents):
            record = state.record[0, index % state.record.shape[1]]
            row, col = (int(place) for place in state.position[0, index])
            known = [
                bool(record[margin + row + rows, margin + col + cols] < 0) for rows, cols in MOVES
            ]
            expected = [True] * len(MOVES) if all(known) else [not wall for wall in known]
            assert seen[agent]["action_mask"].astype(bool).tolist() == expected
            closed += sum(known)
        seen, *_ = env.step({agent: int(rng.integers(len(MOVES))) for agent in env.agents})
    assert closed


def test_a_mask_is_all_ones_between_known_walls() -> None:
    env = make(action_masks=True)
    env.reset(seed=0)
    env.world.state.record.fill_(-1.0)
    assert all(seen["action_mask"].all() for seen in env._observations().values())


@pytest.mark.slow
def test_masked_actions_bump_into_no_wall_of_a_memorised_house() -> None:
    env = make("env.knowledge=memorised", action_masks=True)
    seen, _ = env.reset(seed=2)
    while env.agents:
        mask = {agent: seen[agent]["action_mask"] for agent in env.agents}
        seen, *_ = env.step({a: env.action_space(a).sample(mask[a]) for a in env.agents})
        assert not env.world.state.bumped.any()


@pytest.mark.slow
def test_the_state_is_the_union_of_all_maps_as_large_as_the_largest_house() -> None:
    env = make("env.memory=private", "env.n_agents=3")
    run_episode(env, seed=0)
    for _ in range(4):  # in houses of other sizes too
        env.reset()
        env.step(dict.fromkeys(env.agents, 1))
        state = env.state()
        assert state.dtype == np.float32 and env.state_space.contains(state)
        world = env.world.state
        rows, cols = int(world.rows), int(world.cols)
        margin = env.world.rules.margin
        now = (world.step + 1).float().view(-1, 1, 1)
        whole = map_value(union_of_maps(world.record), now, env.world.rules)[0, margin:, margin:]
        assert (state[:rows, :cols] == whole[:rows, :cols].numpy()).all()
        assert {tuple(place) for place in np.argwhere(state == 1).tolist()} == {
            tuple(place) for place in world.position[0].tolist()
        }


@pytest.mark.slow
def test_pictures_show_the_world_and_text_shows_its_progress(
    capsys: pytest.CaptureFixture[str],
) -> None:
    env = make(render_mode="ansi")
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 0))
    text = env.render()
    assert isinstance(text, str) and "step 1 " in text
    shown = make(render_mode="human")
    shown.reset(seed=0)
    shown.step(dict.fromkeys(shown.agents, 0))
    assert capsys.readouterr().out.endswith(f"{text}\n")
    pixels = make(render_mode="rgb_array")
    pixels.reset(seed=0)
    picture = pixels.render()
    assert isinstance(picture, np.ndarray) and picture.dtype == np.uint8
    pixels.step(dict.fromkeys(pixels.agents, 0))
    assert (pixels.render() != picture).any()


def test_after_the_end_no_actions_return_empty_dicts() -> None:
    env = make("env.max_steps=1")
    env.reset()
    env.step(dict.fromkeys(env.agents, 0))
    assert env.agents == [] and env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.slow
def test_keywords_and_overrides_make_the_same_world() -> None:
    by_keywords = parallel_env(FEW, n_agents=3, adjacency=True, env={"memory": "private"})
    by_overrides = make("env.n_agents=3", "env.memory=private", adjacency=True)
    assert by_keywords.possible_agents == ["robot_0", "robot_1", "robot_2"]
    assert data_equivalence(
        run_episode(by_keywords, seed=1), run_episode(by_overrides, seed=1), exact=True
    )


@pytest.mark.parametrize("mode", ["rgb_array", "ansi", "human"])
def test_before_the_first_reset_it_shows_how_that_will_begin(
    mode: str, capsys: pytest.CaptureFixture[str]
) -> None:
    env = make(render_mode=mode)
    before = env.render(), capsys.readouterr().out
    env.reset()
    capsys.readouterr()
    after = env.render(), capsys.readouterr().out
    assert np.array_equal(before[0], after[0]) and before[1] == after[1]
    assert (mode == "human") == (before[0] is None) == bool(before[1])


@pytest.mark.parametrize(
    ("extras", "names"),
    [
        ({}, None),
        ({"adjacency": True}, {"observation", "adjacency"}),
        ({"action_masks": True}, {"observation", "action_mask"}),
    ],
)
def test_a_plain_box_where_nothing_else_is_in_it(
    extras: dict[str, bool], names: set[str] | None
) -> None:
    env = make(**extras)
    seen, _ = env.reset(seed=0)
    for agent in env.agents:
        space = env.observation_space(agent)
        assert isinstance(space, Box) if names is None else set(space) == names
        assert space.contains(seen[agent])
    shown = seen["robot_0"] if names is None else seen["robot_0"]["observation"]
    assert (shown == env._now[keys.OBSERVATION][0, 0].numpy()).all()
    copied = shown.copy()
    env.step(dict.fromkeys(env.agents, 1))
    assert (shown == copied).all()


@family(
    ("spoil", "words"),
    [
        (lambda: parallel_env(["env.n_agent=3"]), "env.n_agent: no such key"),
        (lambda: parallel_env(n_agent=3), "n_agent: no such key; did you mean env.n_agents"),
        (lambda: parallel_env("env.n_agents=3"), "give a list"),
        (lambda: parallel_env(render_mode="rgb"), "rgb_array"),
        (lambda: make().render(), "render_mode=None"),
        (lambda: make().step({"robot_0": 0, "robot_1": 0}), "call reset"),
        (lambda: make().reset(seed=-1), "seed=-1"),
        (lambda: make().reset(seed=True), "seed=True"),
        (lambda: started().step({"robot_0": 0}), "robot_1"),
        (lambda: started().step({"robot_0": 0, "robot_1": 0, "robot_2": 0}), "robot_2"),
        (lambda: started().step({"robot_0": 0, "robot_1": 4}), "robot_1=4: must be 0 to 3"),
        (lambda: started().step({"robot_0": -1, "robot_1": 0}), "robot_0=-1: must be 0 to 3"),
        (lambda: started().step({"robot_0": 0.5, "robot_1": 1}), "robot_0=0.5"),
    ],
    fast=3,
)
def test_bad_input_is_one_line(spoil: Any, words: str) -> None:
    with pytest.raises(BadInput, match=words) as caught:
        spoil()
    assert "\n" not in str(caught.value)


def started() -> ParallelCleaning:
    env = make()
    env.reset(seed=0)
    return env


def test_without_pettingzoo_the_module_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "marl_clean.pettingzoo")
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'marl-clean\[pettingzoo\]'"):
        importlib.import_module("marl_clean.pettingzoo")
