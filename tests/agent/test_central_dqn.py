"""The central controller: joint actions, the sum of rewards, updates like plain PyTorch's."""

import copy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import check_fit
from marl_clean.config.stored import compose_for_policy
from marl_clean.errors import BadInput
from marl_clean.learning.joint_actions import decode_joint, encode_joint
from tests.agent.parts import transitions

CENTRAL = ["agent=central_dqn", "comm=none", "reward=team", "train_houses=8", "env.num_envs=6"]


def make(*overrides: str):
    """Env and learner of a composed config."""
    torch.manual_seed(0)
    cfg = compose_config([*CENTRAL, *overrides])
    env = build.make_env(cfg)
    return env, build.make_agent(cfg, env)


@pytest.mark.parametrize("n_agents", range(1, 6))
def test_joint_actions_decode_without_loss(n_agents):
    joint = torch.arange(4**n_agents)
    parts = decode_joint(joint, n_agents)
    assert parts.shape == (4**n_agents, n_agents)
    assert torch.equal(encode_joint(parts), joint)
    assert len(set(map(tuple, parts.tolist()))) == 4**n_agents


@pytest.mark.slow
@given(st.lists(st.integers(0, 3), min_size=1, max_size=5))
def test_robot_0_is_the_lowest_digit(actions):
    number = int("".join(map(str, reversed(actions))), 4)
    assert encode_joint(torch.tensor(actions)) == number


@pytest.mark.slow
def test_the_best_joint_action_is_taken_by_its_robots():
    env, agent = make("env.n_agents=3")
    td = agent.policy()(env.reset())
    value = td[keys.JOINT_ACTION_VALUE]
    assert value.shape == (6, 64)
    best = value.argmax(-1)
    assert torch.equal(td[keys.ACTION], torch.stack([best % 4, best // 4 % 4, best // 16], -1))


@pytest.mark.slow
def test_exploration_draws_joint_actions():
    env, agent = make("env.num_envs=512", "env.n_agents=2")
    agent.anneal(0.0)
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        td = agent.exploration(env.full_action_spec)(env.reset())
    counts = torch.bincount(td[keys.JOINT_ACTION], minlength=16)
    assert counts.min() > 10  # 32 expected of each
    assert torch.equal(decode_joint(td[keys.JOINT_ACTION], 2), td[keys.ACTION])


@pytest.mark.slow
def test_it_is_paid_exactly_the_sum_of_the_robots_rewards():
    env, agent = make("env.n_agents=4")
    td = env.rollout(20, break_when_any_done=False)[:, -1]
    td[keys.STEPS_TO_NEXT_OBS] = torch.ones(6, dtype=torch.int64)
    learnt = agent.reward(agent._frames_to_learn(td))
    assert torch.equal(learnt, td["next", keys.OWN_REWARD].sum(-2))


@pytest.mark.slow
@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("n_agents", [1, 3])
def test_updates_equal_plain_pytorch(double, n_agents):
    _, agent = make(
        f"agent.double={double}",
        f"env.n_agents={n_agents}",
        "agent.precision=float32",
        "observation.view_size=9",
        "agent.lr_end=0.001",
    )
    network, target = copy.deepcopy(agent.network), copy.deepcopy(agent.network)
    adam = torch.optim.Adam(network.parameters(), lr=1e-3, fused=True)
    for seed in range(5):
        batch = transitions(8, n_agents, seed)
        team = batch["next", keys.REWARD].sum(-2, keepdim=True).expand(8, n_agents, 1).clone()
        batch["next", keys.REWARD] = team
        then = batch["next", keys.OBSERVATION]
        with torch.no_grad():
            best = (network if double else target)(then).argmax(-1, keepdim=True)
            value = target(then).gather(-1, best)[:, 0]
            discount = 0.95 ** batch[keys.STEPS_TO_NEXT_OBS]
            goal = team[:, 0, 0] + discount * ~batch["next", "terminated"][:, 0] * value
        joint = sum(batch[keys.ACTION][:, robot] * 4**robot for robot in range(n_agents))
        chosen = network(batch[keys.OBSERVATION]).gather(-1, joint[:, None])[:, 0]
        loss = nn.functional.smooth_l1_loss(chosen, goal)
        adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        adam.step()
        for slow, fast in zip(target.parameters(), network.parameters(), strict=True):
            slow.data.lerp_(fast.data, 0.005)
        torch.testing.assert_close(agent.update(batch)["loss"], loss.detach())
    for learned, expected in zip(agent.network.parameters(), network.parameters(), strict=True):
        torch.testing.assert_close(learned, expected)


@pytest.mark.slow
def test_six_robots_are_too_many():
    with pytest.raises(BadInput, match=r"env.n_agents=6: .* at most 1,024 .5 robots"):
        make("env.n_agents=6")


@pytest.mark.slow
def test_weights_of_two_robots_do_not_play_with_three(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = compose_config([*CENTRAL, "name=two"])
    (tmp_path / "runs" / "two").mkdir(parents=True)
    OmegaConf.save(config, tmp_path / "runs" / "two" / "config.yaml")
    with pytest.raises(BadInput, match=r"^env.n_agents: 3 does not fit checkpoint two"):
        compose_for_policy(["checkpoint=two", "env.n_agents=3"])
    compose_for_policy(["checkpoint=two", "env.num_envs=3"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("comm=plan", "comm=plan: does not fit agent=central_dqn; valid: none"),
        ("reward=individual", "reward=individual: does not fit agent=central_dqn; valid: team"),
    ],
)
def test_levels_that_do_not_fit_are_refused(override, expected):
    with pytest.raises(BadInput, match=f"^{expected}$"):
        check_fit(compose_config([*CENTRAL, override]))
