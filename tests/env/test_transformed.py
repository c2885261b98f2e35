"""A step without detours gives what TorchRL's own method gives, key by key and to the bit."""

from functools import cache

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import StepCounter, TransformedEnv

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.levels import rooms
from marl_clean.env.transformed import TransformedWorlds
from tests.env.resets import count_short_resets
from tests.families import family

pytestmark = pytest.mark.usefixtures("unchecked")

SMALL = [
    "train_houses=8",
    "house.rows=[4,6]",
    "house.cols=[4,7]",
    "env.num_envs=9",
    "env.n_agents=3",
    "env.max_steps=8",
    "env.stuck_after=5",
    "observation.view_size=5",
]
NO_VIEW = [setting for setting in SMALL if "view_size" not in setting]
VECTOR = ["encoder=mlp", "agent.augment=false"]
CASES = {
    **{f"topology={level}": [*SMALL, f"topology={level}"] for level in rooms()["topology"]},
    **{f"reward={level}": [*SMALL, f"reward={level}"] for level in rooms()["reward"]},
    "observation=frontier": [*SMALL, "observation=frontier"],
    "observation=pyramid": [*NO_VIEW, "observation=pyramid"],
    "observation=global_map": [*NO_VIEW, "observation=global_map"],
    "observation=distances": [*NO_VIEW, "observation=distances", *VECTOR],
    "private": [*SMALL, "env.memory=private"],
    "merged": [*SMALL, "env.memory=merged", "topology=full"],
    "noise": [*SMALL, "env.bump_noise=0.3", "observation.position_noise=0.3"],
    "furniture": [*SMALL, "env.furniture_moves_per_episode=3", "env.sensor=touch4"],
    "spills": [*SMALL, "env.spills.per_episode=4", "env.memory=private"],
    "lossy": [*SMALL, "channel=[lossy,delayed]", "channel.lossy.burst_start=0.2"],
    "gru": [*SMALL, "encoder.memory=gru"],
    "state": [*SMALL, "agent=qmix", "reward=team"],
    "mask": [*SMALL, "agent.mask_walls=true", "env.memory=private"],
    "shaping": [*SMALL, "env.shaping=0.5", "env.memory=merged"],
    "team": [
        *(*SMALL, "env.memory=merged", "env.knowledge=[memorised,unknown,memorised]"),
        *("env.paid_by=team_map", "env.collision_pays=-1", "env.robots_shown=false"),
    ],
    "one robot": [*SMALL, "env.n_agents=1"],
}


composed = cache(compose_config)  # two envs of each are played


def make(settings: list[str]) -> tuple[TransformedWorlds, list]:
    """An env, and the keys that its robots' policy carries from step to step."""
    cfg = composed(tuple(settings))
    torch.manual_seed(0)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    return build.ready_for(agent, env), list(agent.network.carries)


def assert_same(ours: TensorDictBase, theirs: TensorDictBase) -> None:
    assert set(ours.keys(True, True)) == set(theirs.keys(True, True))
    for key in theirs.keys(True, True):
        assert ours[key].dtype == theirs[key].dtype, key
        assert torch.equal(ours[key], theirs[key]), key
    assert ours.batch_size == theirs.batch_size and ours.device == theirs.device


@pytest.mark.slow
@family("case", CASES, fast=[], usual=8)
def test_steps_and_resets_are_torchrls(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (env, carries), (reference, _) = make(CASES[case]), make(CASES[case])
    assert type(env) is TransformedWorlds
    reference.__class__ = TransformedEnv
    begun = count_short_resets(monkeypatch)
    mine, theirs = env.reset(), reference.reset()
    assert_same(mine, theirs)
    generator = torch.Generator().manual_seed(1)
    for step in range(20):  # two episodes and more
        action = torch.randint(4, (9, env.base_env.n_agents), generator=generator)
        for frame in (mine, theirs):
            frame[keys.ACTION] = action
            frame["of the policy"] = torch.full((9, 2), step)
            for key in carries:
                frame.set(("next", key), torch.full_like(frame[key], step % 2))
        first, mine = env.step_and_maybe_reset(mine)
        second, theirs = reference.step_and_maybe_reset(theirs)
        assert_same(first, second)
        assert_same(mine, theirs)
    assert any(0 < count < 9 for count in begun)
    saved = reference.base_env.state_dict()
    for name, value in env.base_env.state_dict().items():
        assert torch.equal(value, saved[name]), name


@pytest.mark.slow
def test_what_was_recorded_does_not_change_later() -> None:
    env, _ = make(SMALL)
    carried = env.reset()
    recorded = []
    for _ in range(30):
        carried = env.rand_action(carried)
        frame, carried = env.step_and_maybe_reset(carried)
        recorded.append((frame, frame.clone()))
    for frame, copy in recorded:
        assert_same(frame, copy)


@pytest.mark.slow
def test_with_other_transforms_torchrls_method_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TransformedWorlds, "begin_anew", lambda *arguments: pytest.fail("direct"))
    env, _ = make(SMALL)
    env.append_transform(StepCounter())
    played = env.rollout(40, break_when_any_done=False)
    assert played["next", keys.DONE].any()
    assert played["step_count"].max() < 14


def test_another_batch_is_refused() -> None:
    env, _ = make(SMALL)
    frame = env.rand_action(env.reset())
    with pytest.raises(RuntimeError, match="shape"):
        env.step_and_maybe_reset(frame[:3])
