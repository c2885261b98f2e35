"""What a network carries from step to step: memory, messages under way, bursts."""

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.learning.acting import begin_carrying, entries
from marl_clean.trainer._collecting import CarriedCollector, Rows, Windows
from tests.families import family

BASE = [
    "train_houses=8",
    "env.num_envs=6",
    "env.n_agents=3",
    "env.max_steps=7",
    "house.rows=[5,7]",
    "house.cols=[5,7]",
    "observation.view_size=9",
    "agent.precision=float32",
    "agent.n_steps=1",
]
CARRYING = {
    "gru": ["encoder.memory=gru"],
    "remembered": ["comm=expocomm", "comm.peers=one"],
    "delayed": ["channel=delayed", "channel.delayed.steps=2"],
    "chosen": ["comm=magic", "channel=delayed", "channel.delayed.steps=2"],
    "drawn": ["channel=delayed", "channel.delayed.steps=2", "channel.delayed.random=true"],
    "bursts": ["channel=lossy", "channel.lossy.burst_start=0.3"],
    "all": [
        "encoder.memory=gru",
        "comm=commnet",
        "channel=[lossy,delayed,noisy]",
        "channel.lossy.burst_start=0.3",
    ],
}


def played(settings: list[str], blocks: int = 2):
    """An agent, and what it plays greedily in blocks of 8 frames a world, values noted."""
    cfg = compose_config([*BASE, *settings])
    torch.manual_seed(0)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    for weight in agent.network.parameters():
        torch.nn.init.normal_(weight, std=0.3)
    env = build.ready_for(agent, env)
    collector = CarriedCollector(
        env,
        agent.policy(),
        frames_per_batch=48,
        total_frames=-1,
        exploration_type=ExplorationType.DETERMINISTIC,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )
    frames = iter(collector)
    taken = [next(frames).clone() for _ in range(blocks)]
    collector.shutdown(close_env=False)
    return cfg, agent, torch.cat(taken, dim=1)


@family("settings", CARRYING.values(), fast=1, ids=CARRYING)
def test_unrolled_rows_say_what_was_played(settings: list[str]) -> None:
    _, agent, frames = played(settings)
    assert frames["next", "done"].any()  # episodes begin within rows
    for key in agent.network.carries:
        assert frames[key].float().abs().sum() > 0
        assert not frames[key][frames[keys.IS_INIT].squeeze(-1)].any()
    row = frames[:, 3:11]  # from the middle of episodes
    seen = entries(agent.network, row)
    value = agent.network.unroll(row[keys.IS_INIT], seen)
    torch.testing.assert_close(value, row[keys.ACTION_VALUE])
    again = agent.network(seen).out  # what is stored with each frame says the same
    torch.testing.assert_close(again, row[keys.ACTION_VALUE])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gru", "delayed", "remembered"])
def test_what_is_carried_matters_and_gradients_cross_steps(kind: str) -> None:
    _, agent, frames = played(CARRYING[kind])
    row = frames[:, 3:11]
    seen = entries(agent.network, row.clone())
    observation = seen[keys.OBSERVATION].requires_grad_()
    value = agent.network.unroll(torch.zeros_like(row[keys.IS_INIT]), seen)
    (grad,) = torch.autograd.grad(value[:, 5].sum(), observation)
    reached = grad.flatten(2).abs().sum((0, 2)).ne(0)
    assert reached[:6].any() and not reached[6:].any()
    assert reached[3]  # two steps before
    begins = torch.zeros_like(row[keys.IS_INIT])
    begins[:, 5] = True
    value = agent.network.unroll(begins, seen)
    (grad,) = torch.autograd.grad(value[:, 5].sum(), observation)
    assert not grad[:, :5].any()  # a new episode remembers nothing


@family("settings", CARRYING.values(), fast=1, ids=CARRYING)
def test_evaluation_carries_what_training_carries(settings: list[str]) -> None:
    """Without primer: a loop that carries all that a step leaves begins with zeros."""
    cfg, agent, frames = played(settings, blocks=1)
    env = build.make_env(cfg)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        policy = agent.policy()
        td = begin_carrying(policy, env.reset())
        for step in range(6):
            td = env.step(policy(td))
            torch.testing.assert_close(td[keys.ACTION_VALUE], frames[:, step][keys.ACTION_VALUE])
            td = step_mdp(td)


@family("settings", CARRYING.values(), fast=1, ids=CARRYING)
def test_what_an_env_does_not_hold_is_named_and_never_made_up(settings: list[str]) -> None:
    cfg = compose_config([*BASE, *settings])
    env = build.make_env(cfg)
    policy = build.make_agent(cfg, env).policy()
    with pytest.raises(BadInput, match="make_tensordict_primer") as caught:
        env.rollout(3, policy)
    assert "\n" not in str(caught.value)
    env.append_transform(policy.make_tensordict_primer())
    env.rollout(3, policy)


def test_an_env_without_draws_is_named() -> None:
    cfg = compose_config([*BASE, "channel=lossy"])
    policy = build.make_agent(cfg, build.make_env(cfg)).policy()
    with pytest.raises(BadInput, match="channel_seed"):
        policy(build.make_env(compose_config(BASE)).reset())


@pytest.mark.slow
def test_rows_are_cut_in_order_whatever_the_blocks() -> None:
    rows, frames = Rows(4), played(CARRYING["gru"])[2].select(keys.IS_INIT, "next")
    cut = [
        row for size in (frames[:, :3], frames[:, 3:10], frames[:, 10:]) for row in rows.full(size)
    ]
    assert [row.shape for row in cut] == [(6, 4)] * (frames.shape[1] // 4)
    whole = torch.cat(cut, dim=1)
    assert (whole == frames[:, : whole.shape[1]]).all()


@pytest.mark.slow
def test_an_update_learns_from_rows() -> None:
    _, agent, frames = played([*CARRYING["gru"], "agent.n_steps=3"])
    windows = Windows(3, 0.95)
    ready = windows.inv(frames.select(*agent.learns_from))
    before = agent.network.encoder.memory.weight_hh.clone()
    measured = agent.update(ready.select(*agent.learns_from, keys.STEPS_TO_NEXT_OBS))
    assert measured["loss"].isfinite()
    assert not torch.equal(before, agent.network.encoder.memory.weight_hh)
