"""Q(lambda) without replay: returns and loss against plain loops, and no network run twice."""

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from marl_clean import keys
from marl_clean.agent.pqn import Pqn
from marl_clean.learning.acting import entries
from marl_clean.testing import agent as contract
from tests.agent.parts import collected, make_learner, transitions
from tests.families import family

SMALL = (
    *contract.SMALL,
    "agent=pqn",
    "trainer=on_policy",
    "agent.precision=float32",
    "agent.dueling=true",
    "house=open",
    "house.rows=[3,4]",
    "house.cols=[3,5]",
    "train_houses=6",
)
CARRYING = {
    "nothing": (),
    "gru": ("encoder.memory=gru",),
    "late": ("channel=delayed", "channel.delayed.steps=2"),
}


def played(*settings: str) -> tuple[Pqn, TensorDict]:
    """A learner, and a block that it collected: episodes of at most 5 steps, some finished."""
    agent, block = collected([*SMALL, *settings])
    assert isinstance(agent, Pqn)
    assert block["next", keys.DONE].any(1).all() and not block["next", keys.DONE][:, -1].all()
    return agent, block


def returns(agent: Pqn, block: TensorDict) -> Tensor:
    """The lambda-returns, written out for each world and robot."""
    with torch.no_grad():
        best = agent.network(entries(agent.network, block["next"])).out.amax(-1)
    reward = block["next", keys.REWARD].squeeze(-1)
    result = torch.zeros_like(reward)
    num_envs, steps, n_agents = reward.shape
    for env in range(num_envs):
        for robot in range(n_agents):
            for t in reversed(range(steps)):
                later = best[env, t, robot]
                if not block["next", keys.DONE][env, t] and t < steps - 1:
                    onward = result[env, t + 1, robot]
                    later = agent.lmbda * onward + (1 - agent.lmbda) * later
                if block["next", keys.TERMINATED][env, t]:
                    later = 0.0
                result[env, t, robot] = reward[env, t, robot] + agent.gamma * later
    return result


@family("settings", CARRYING.values(), fast=1, ids=CARRYING)
def test_returns_are_those_of_a_plain_loop(settings: tuple[str, ...]) -> None:
    agent, block = played(*settings)
    block["next", keys.TERMINATED][0] = block["next", keys.DONE][0]  # as if they had finished
    block["next", keys.TERMINATED][1] = False
    learnt = agent.estimate(block)
    torch.testing.assert_close(learnt[keys.VALUE_TARGET].squeeze(-1), returns(agent, block))


@pytest.mark.slow
def test_a_frame_goes_through_the_network_once_in_acting_and_once_behind_an_end() -> None:
    agent, block = played()
    counted = []
    agent.network.register_forward_hook(lambda module, seen, out: counted.append(len(out.out)))
    agent.estimate(block)
    ends = block["next", keys.DONE].squeeze(-1).clone()
    ends[:, -1] = True
    assert counted == [int(ends.sum())]


@pytest.mark.parametrize("loss", ["smooth_l1", "l2"])
def test_the_loss_by_hand(loss: str) -> None:
    agent = make_learner("pqn", "plan", loss=loss, lr=0.01)
    batch = transitions(10)
    batch[keys.VALUE_TARGET] = 3 * torch.randn(10, 2, 1)
    value = agent.network(entries(agent.network, batch)).out
    away = value.gather(-1, batch[keys.ACTION].unsqueeze(-1)) - batch[keys.VALUE_TARGET]
    small = away.square() / 2
    huber = torch.where(away.abs() < 1, small, away.abs() - 0.5)
    expected = (huber if loss == "smooth_l1" else 2 * small).mean().detach()
    torch.testing.assert_close(agent.update(batch)["loss"], expected)


def test_the_step_is_radams_and_both_schedules_fall() -> None:
    agent = make_learner("pqn", "plan", radam_eps=1e-5)
    (group,) = agent._optimiser.param_groups
    assert isinstance(agent._optimiser, torch.optim.RAdam) and group["eps"] == 1e-5
    seen = []
    for progress in (0.0, 0.05, 0.5, 1.0):
        agent.anneal(progress)
        seen.append((agent.measures()["epsilon"], group["lr"]))
    expected = [(1.0, 1e-3), (0.51, 9.55e-4), (0.02, 5.5e-4), (0.02, 1e-4)]
    for actual, wanted in zip(seen, expected, strict=True):
        assert actual == pytest.approx(wanted)
