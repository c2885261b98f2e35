"""The mask of known walls: equal to the plain reference, by both step methods."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from torchrl.envs import TransformedEnv, check_env_specs

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import check_fit
from marl_clean.env.action_mask import KnownWalls
from marl_clean.errors import BadInput
from tests.env.resets import count_short_resets
from tests.families import family
from tests.world.play import env_of, start
from tests.world.strategies import Case, cases

SMALL = [
    "train_houses=8",
    "house.rows=[4,6]",
    "house.cols=[4,7]",
    "env.num_envs=9",
    "env.n_agents=3",
    "env.stuck_after=5",
]
MEMORIES = ("shared", "private", "merged")


def config(*settings: str):
    cfg = compose_config([*SMALL, *settings])
    cfg.agent = {**cfg.agent, "mask_walls": True}
    return cfg


@pytest.mark.long
@given(case=cases())
@hypothesis_settings(max_examples=30, deadline=None)
def test_every_mask_of_random_episodes_is_the_reference(case: Case) -> None:
    env = env_of([case])
    env.append_transform(KnownWalls())
    world, tensordict = case.world(), start(env, [case])
    for actions in case.actions:
        masks = [world.action_mask(robot) for robot in range(len(world.positions))]
        assert tensordict[keys.ACTION_MASK][0].tolist() == masks
        tensordict[keys.ACTION] = torch.tensor([actions])
        tensordict = env.step(tensordict)["next"]
        outcome = world.step(actions)
        if outcome.terminated or outcome.truncated:
            break


@family("memory", MEMORIES, fast=1)
def test_the_spec_holds_and_steps_and_resets_are_torchrls(
    memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg = config(f"env.memory={memory}")
    env, reference = build.make_env(cfg), build.make_env(cfg)
    check_env_specs(env, check_dtype=True)
    assert env.observation_spec[keys.ACTION_MASK].dtype == torch.bool
    env.set_seed(0)
    reference.__class__ = TransformedEnv
    begun = count_short_resets(monkeypatch)
    mine, theirs = env.reset(), reference.reset()
    generator = torch.Generator().manual_seed(1)
    closed = 0
    for _ in range(40):
        mask = mine[keys.ACTION_MASK]
        assert torch.equal(mask, theirs[keys.ACTION_MASK])
        closed += int((~mask).sum())
        action = torch.randint(4, (9, 3), generator=generator)
        mine[keys.ACTION] = theirs[keys.ACTION] = action
        first, mine = env.step_and_maybe_reset(mine)
        second, theirs = reference.step_and_maybe_reset(theirs)
        assert torch.equal(first["next", keys.ACTION_MASK], second["next", keys.ACTION_MASK])
    assert closed and any(0 < count < 9 for count in begun)


def test_a_robot_between_known_walls_has_no_action_masked() -> None:
    env = build.make_env(config())
    env.reset()
    env.base_env.state.record.fill_(-1.0)
    assert env.transform[2].read(env.base_env.state, env.base_env.setup)[keys.ACTION_MASK].all()


@pytest.mark.slow
def test_a_policy_that_keeps_to_the_mask_bumps_into_no_wall_of_a_memorised_house() -> None:
    env = build.make_env(config("env.knowledge=memorised"))
    tensordict = env.reset()
    for _ in range(30):
        choice = tensordict[keys.ACTION_MASK].flatten(0, 1).float().multinomial(1)
        tensordict[keys.ACTION] = choice.view(9, 3)
        _, tensordict = env.step_and_maybe_reset(tensordict)
        assert not env.base_env.state.bumped.any()


def test_without_the_setting_there_is_no_mask() -> None:
    env = build.make_env(compose_config(SMALL))
    assert keys.ACTION_MASK not in env.observation_spec.keys(True, True)


@pytest.mark.slow
def test_a_mask_where_there_are_no_walls_is_refused() -> None:
    cfg = compose_config(["env=pettingzoo", "encoder=mlp", "topology=full", "agent.augment=false"])
    check_fit(cfg)
    cfg.agent = {**cfg.agent, "mask_walls": True}
    with pytest.raises(BadInput, match="^agent.mask_walls=true: a mask where there are no walls"):
        check_fit(cfg)
