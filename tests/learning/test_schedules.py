"""Schedules over a run, compared with plain arithmetic."""

import pytest
import torch
from tensordict import TensorDict

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.shaping import Shaping
from marl_clean.learning.schedules import Discount, linear
from marl_clean.trainer._annealing import WINDOW_EPISODES, Annealing
from marl_clean.trainer._collecting import Windows
from tests.agent.parts import LEARNERS, make_learner, transitions


def test_a_discount_without_an_end_stays() -> None:
    stays = Discount(0.9, None, "successes")
    assert {stays.at(progress, finished) for progress in (0.0, 1.0) for finished in (0.0, 1.0)} == {
        0.9
    }


@pytest.mark.parametrize(("rises_with", "expected"), [("progress", 0.92), ("successes", 0.98)])
def test_a_discount_moves_with_what_it_is_to_move_with(rises_with: str, expected: float) -> None:
    assert Discount(0.9, 1.0, rises_with).at(0.2, 0.8) == pytest.approx(expected)


def test_nothing_goes_beyond_its_end() -> None:
    assert [linear(2.0, 4.0, progress) for progress in (0.0, 0.25, 1.0, 1.5)] == [2, 2.5, 4, 4]


@pytest.mark.parametrize("level", LEARNERS)
def test_every_learner_has_the_present_discount(level: str) -> None:
    comm = "none" if level == "central_dqn" else "plan"
    agent = make_learner(level, comm, gamma=0.5, gamma_end=0.9, gamma_rises_with="successes")
    assert agent.gamma == 0.5
    agent.anneal(0.1, finished=0.5)
    assert agent.gamma == pytest.approx(0.7)
    assert agent.measures()["gamma"] == agent.gamma
    assert "gamma" not in make_learner(level, comm).measures()


@pytest.mark.parametrize("level", ["ippo", "pqn"])
def test_returns_of_a_block_are_discounted_as_is_due(level: str) -> None:
    """With lambda 1 the first of two frames is worth r_0 + gamma r_1, ended then."""
    agent = make_learner(level, "plan", gamma=0.5, gamma_end=0.9, lmbda=1.0)
    agent.anneal(0.5)
    block = transitions(2).unsqueeze(0)
    block[keys.LOG_PROB] = torch.zeros(1, 2, 2)
    block[keys.ACTION_VALUE] = torch.zeros(1, 2, 2, 4)
    ends = torch.tensor([[[False], [True]]])
    block["next", keys.DONE], block["next", keys.TERMINATED] = ends, ends.clone()
    reward = block["next", keys.REWARD]
    target = agent.estimate(block.select(*agent.learns_from))[keys.VALUE_TARGET]
    torch.testing.assert_close(target[:, 0], reward[:, 0] + 0.7 * reward[:, 1])


def test_windows_sum_by_the_present_discount() -> None:
    windows = Windows(2, 0.5)
    windows.gamma = 0.25
    agents = TensorDict({"reward": torch.ones(1, 4, 2, 1)}, [1, 4, 2])
    done = torch.zeros(1, 4, 1, dtype=torch.bool)
    later = TensorDict({"agents": agents, "done": done, "terminated": done.clone()}, [1, 4])
    summed = windows.inv(TensorDict({"next": later}, [1, 4]))
    assert summed["next", keys.REWARD].unique().tolist() == [1.25]


def test_successes_are_of_recent_episodes() -> None:
    successes, expected = Annealing(), 0.0
    generator = torch.Generator().manual_seed(0)
    for block in range(300):
        done = torch.rand(8, 16, generator=generator) < 0.05
        finished = done & (torch.rand(8, 16, generator=generator) < (0.9 if block > 150 else 0.2))
        successes.note(done, finished)
        ended = int(done.sum())
        kept = (1 - 1 / WINDOW_EPISODES) ** ended
        share = int(finished.sum()) / ended if ended else 0.0
        expected = kept * expected + (1 - kept) * share
    assert successes.share == pytest.approx(expected)
    assert 0.6 < successes.share < 0.9
    before = successes.share
    successes.note(torch.zeros(2, 3, dtype=torch.bool), torch.zeros(2, 3, dtype=torch.bool))
    assert successes.share == before


def test_shaped_rewards_are_discounted_as_the_learners() -> None:
    small = ["env.shaping=0.5", "env.num_envs=2", "train_houses=4"]
    env = build.make_env(compose_config(small))
    agent = make_learner("iql", "plan", gamma=0.5, gamma_end=0.9)
    Annealing().set(agent, env, 0.5)
    (shaping,) = (t for t in env.transforms if isinstance(t, Shaping))
    assert shaping.gamma == agent.gamma == pytest.approx(0.7)
