"""The env as TorchRL sees it: specs, seeds, partial resets, saving and loading."""

import numpy as np
import pytest
import torch
from torchrl.envs import check_env_specs

from marl_clean import keys
from marl_clean.build import make_env
from marl_clean.config.compose import compose_config
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.rooms import Rooms
from marl_clean.settings import HouseOrder, Memory, Sensor
from marl_clean.world.rules import Rules
from tests.families import family
from tests.world.play import houses_of

HOUSES = draw_houses(Rooms([6, 9], [6, 9]), range(40), n_agents=3)
READINGS = [
    [],
    ["env.memory=private", "topology=sight"],
    ["env.memory=merged", "topology=radius", "reward=team"],
    ["env.knowledge=memorised", "env.sensor=touch4", "topology=full"],
    ["env.knowledge=stale", "env.furniture_moves_before_start=3", "reward=individual"],
    ["env.furniture_moves_per_episode=4", "topology=none"],
]


def small_env(*overrides: str, num_envs: int = 6, seed: int = 0, **changes):
    cfg = compose_config(["env.n_agents=3", f"seed={seed}", *overrides])
    return make_env(cfg, HOUSES, num_envs=num_envs, **changes)


def actions_for(steps: int, num_envs: int, n_agents: int = 3) -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    return torch.randint(0, 4, (steps, num_envs, n_agents), generator=generator)


def stepped(env, actions: torch.Tensor, tensordict=None) -> list:
    """Step through resets and return what every step recorded."""
    tensordict = env.reset() if tensordict is None else tensordict
    steps = []
    for action in actions:
        tensordict[keys.ACTION] = action
        step, tensordict = env.step_and_maybe_reset(tensordict)
        steps.append(step.clone())
    return steps


@family("overrides", READINGS, fast=2, ids=" ".join)
def test_specs_hold(overrides: list[str]) -> None:
    env = small_env(*overrides)
    check_env_specs(env, check_dtype=True)
    rollout = env.rollout(50, break_when_any_done=False)
    assert rollout[keys.OBSERVATION].shape == (6, 50, 3, 1, 15, 15)


@pytest.mark.long
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("overrides", READINGS, ids=" ".join)
def test_equal_seeds_give_equal_episodes_and_other_seeds_others(overrides: list[str]) -> None:
    """Over many resets, to the last bit."""
    actions = actions_for(150, 6)
    first, again, other = (
        torch.stack(stepped(small_env(*overrides, "env.stuck_after=8", seed=seed), actions))
        for seed in (3, 3, 4)
    )
    assert first["next", keys.DONE].sum() > 20
    assert (first == again).all()
    assert not (first == other).all()


@pytest.mark.slow
def test_set_seed_starts_over() -> None:
    actions = actions_for(60, 6)
    env = small_env(seed=1)
    env.set_seed(5)
    first = torch.stack(stepped(env, actions))
    env.set_seed(5)
    assert (first == torch.stack(stepped(env, actions))).all()


@pytest.mark.slow
def test_env_i_of_many_is_env_i_alone() -> None:
    actions = actions_for(300, 8)
    rules = Rules(stuck_after=15)
    together = CleaningEnv(HOUSES, rules, n_agents=3, num_envs=8, seed=2)
    steps = torch.stack(stepped(together, actions))
    for index in (0, 5, 7):
        alone = CleaningEnv(HOUSES, rules, n_agents=3, num_envs=1, seed=2, first_env=index)
        alone_steps = torch.stack(stepped(alone, actions[:, index : index + 1]))
        assert (alone_steps[:, 0] == steps[:, index]).all()


@pytest.mark.slow
def test_a_partial_reset_touches_no_other_world_and_no_recorded_step() -> None:
    env = small_env(num_envs=5)
    steps = stepped(env, actions_for(10, 5))
    recorded = [step.clone() for step in steps]
    before = {name: value.clone() for name, value in env.base_env.state.tensors().items()}
    tensordict = steps[-1]["next"].clone().select(keys.AGENTS, *keys.ENDINGS)
    mask = torch.tensor([False, True, False, False, True])[:, None]
    tensordict["_reset"] = mask
    after = env.reset(tensordict.clone())
    keep = ~mask[:, 0]
    for name, value in env.base_env.state.tensors().items():
        assert torch.equal(value[keep], before[name][keep]), name
    assert env.base_env.state.step.tolist() == [10, 0, 10, 10, 0]
    assert (after[keys.OBSERVATION][keep] == tensordict[keys.OBSERVATION][keep]).all()
    assert env.base_env.state.episode.tolist() == [0, 1, 0, 0, 1]
    assert all((kept == step).all() for kept, step in zip(recorded, steps, strict=True))
    # what the reset worlds show is what they hold
    fresh = env.transform[1].read(env.base_env.state, env.base_env.setup)
    assert torch.equal(fresh[keys.OBSERVATION], after[keys.OBSERVATION])


@family("overrides", READINGS, fast=2, ids=" ".join)
def test_a_loaded_state_resumes_exactly(overrides: list[str]) -> None:
    actions = actions_for(60, 6)
    env = small_env(*overrides, "env.stuck_after=10")
    steps = stepped(env, actions[:30])
    saved = env.base_env.state_dict()
    carried = steps[-1]["next"].exclude(keys.REWARD)
    carried[keys.DONE].zero_(), carried[keys.TRUNCATED].zero_(), carried[keys.TERMINATED].zero_()
    expected = torch.stack(stepped(env, actions[30:], carried.clone()))
    other = small_env(*overrides, "env.stuck_after=10", seed=9)
    other.reset()
    other.base_env.load_state_dict(saved)
    assert (torch.stack(stepped(other, actions[30:], carried.clone())) == expected).all()


def test_a_state_of_other_sizes_is_refused() -> None:
    with pytest.raises(BadInput, match="sizes or names"):
        small_env(num_envs=4).base_env.load_state_dict(small_env(num_envs=3).base_env.state_dict())


@pytest.mark.slow
def test_a_transform_adds_up_what_neighbours_earn() -> None:
    """Contact of the moment the actions were chosen, not of the moment after."""
    free = np.ones((1, 12), dtype=bool)
    houses = houses_of(free, None, [(0, 0), (0, 8)])
    cfg = compose_config(["env.n_agents=2"])
    env = make_env(cfg, houses, num_envs=1)
    tensordict = env.reset()
    assert not tensordict[keys.ADJACENCY].any()  # 8 apart, the view reaches 7
    tensordict[keys.ACTION] = torch.tensor([[1, 3]])
    after = env.step(tensordict)["next"]
    assert after[keys.ADJACENCY].any()
    assert torch.equal(after[keys.REWARD], after[keys.OWN_REWARD])
    torch.testing.assert_close(after[keys.OWN_REWARD].flatten(), torch.tensor([3.4, 3.4]))
    tensordict = after.clone()
    tensordict[keys.ACTION] = torch.tensor([[1, 0]])
    after = env.step(tensordict)["next"]
    torch.testing.assert_close(after[keys.OWN_REWARD].flatten(), torch.tensor([3.4, 1.0]))
    torch.testing.assert_close(after[keys.REWARD].flatten(), torch.tensor([4.4, 4.4]))


def test_default_limit_is_of_each_houses_own_size() -> None:
    env = CleaningEnv(HOUSES, n_agents=3, num_envs=40, house_order=HouseOrder.FIXED)
    rows, cols = torch.from_numpy(HOUSES.rows), torch.from_numpy(HOUSES.cols)
    assert torch.equal(env.state.max_steps, 4 * rows * cols // 3 + 50)
    assert len(set(env.state.max_steps.tolist())) > 3


def test_fixed_order_puts_house_i_in_env_i_and_random_order_draws() -> None:
    fixed = CleaningEnv(HOUSES, n_agents=3, num_envs=40, house_order=HouseOrder.FIXED)
    assert fixed.state.house.tolist() == list(range(40))
    drawn = CleaningEnv(HOUSES, n_agents=3, num_envs=400)
    assert len(set(drawn.state.house.tolist())) > 35


@pytest.mark.slow
def test_render_gives_frames_of_one_size() -> None:
    env = small_env()
    env.reset()
    frame = env.base_env.render(2)
    assert frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3
    assert (env.base_env.render(2) == frame).all()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"rules": Rules(memory=Memory.PRIVATE)}, "contact"),
        ({"n_agents": 99}, "n_agents"),
        ({"furniture_moves_before_start": 2}, "knowledge=stale"),
    ],
)
def test_bad_settings_are_named(changes: dict, word: str) -> None:
    with pytest.raises(BadInput, match=word):
        CleaningEnv(HOUSES, **changes)


def test_touch_knows_the_four_neighbours_at_once() -> None:
    houses = houses_of([[True, True], [False, True]], None, [(0, 0)])
    env = CleaningEnv(houses, Rules(sensor=Sensor.TOUCH4), n_agents=1, num_envs=1)
    env.reset()
    margin = env.rules.margin
    record = env.state.record[0, 0, margin - 1 : margin + 2, margin - 1 : margin + 2]
    assert record.tolist() == [[0.0, -1.0, 0.0], [-1.0, 1.0, 0.5], [0.0, -1.0, 0.0]]


@pytest.mark.long
def test_a_compiled_env_steps_as_a_plain_one_and_keeps_its_maps(run_script):
    run_script("tests.env.compiled")


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [[], ["reward=team"], ["agent=qmix", "reward=team"]])
def test_what_a_robot_is_paid_is_the_only_reward(overrides: list[str]) -> None:
    env = small_env(*overrides)
    assert env.reward_keys == [keys.REWARD] and env.reward_key == keys.REWARD
    first = env.reset()
    for key in (keys.OWN_REWARD, keys.INFO_STEP, keys.INFO_CLEANING, keys.INFO_DISCOVERY):
        assert key in env.observation_keys
        assert (first[key] == 0).all() and first[key].shape == (6, 3, 1)


def test_a_bare_env_pays_what_a_robot_earns() -> None:
    env = CleaningEnv(HOUSES, n_agents=3, num_envs=4)
    check_env_specs(env, check_dtype=True)
    after = env.step(env.rand_action(env.reset()))["next"]
    assert torch.equal(after[keys.REWARD], after[keys.OWN_REWARD])
    terms = (after[key] for key in (keys.INFO_STEP, keys.INFO_CLEANING, keys.INFO_DISCOVERY))
    torch.testing.assert_close(sum(terms), after[keys.OWN_REWARD])


@pytest.mark.parametrize("wrong", [-1, 4])
def test_an_action_that_does_not_exist_is_refused_before_anything_moves(wrong: int) -> None:
    env = small_env()
    tensordict = env.reset()
    before = env.base_env.state_dict()
    for step in (env.step, env.step_and_maybe_reset):
        tensordict[keys.ACTION] = torch.zeros(6, 3, dtype=torch.int64)
        tensordict[keys.ACTION][2, 1] = wrong
        with pytest.raises(BadInput, match=f"^action {wrong}: valid: 0 up, 1 right, 2 down, 3"):
            step(tensordict)
    for name, value in env.base_env.state_dict().items():
        assert torch.equal(value, before[name]), name
