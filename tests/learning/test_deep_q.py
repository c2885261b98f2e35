"""Deep Q-learning's one readable loss against TorchRL's own losses, value and gradients."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import QValueModule
from torchrl.objectives import DQNLoss, LossModule, QMixerLoss, ValueEstimators

from marl_clean import keys
from marl_clean.agent.iql import Iql
from marl_clean.agent.qmix import Qmix
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.mixed_q import MIXER
from marl_clean.learning.networks import QNetwork
from tests.agent.parts import (
    IQL,
    STATE_SHAPE,
    make_agent,
    make_comm,
    make_encoder,
    make_learner,
    transitions,
)

ROBOTS_DONE, ROBOTS_TERMINATED = (keys.AGENTS, "done"), (keys.AGENTS, "terminated")
LOSSES = ("smooth_l1", "l2", "l1")
pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")  # none is moved here


class Values(nn.Module):
    """A network's action values, from entries in the order of its `sees`."""

    def __init__(self, network: QNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *entries: Tensor) -> Tensor:
        return self.network(dict(zip(self.network.sees, entries, strict=True))).out


def actor(network: QNetwork) -> TensorDictSequential:
    """The network as TorchRL's losses want it: its values, then TorchRL's own choice of action."""
    values = TensorDictModule(
        Values(network), in_keys=list(network.sees), out_keys=[keys.ACTION_VALUE]
    )
    choice = QValueModule(
        action_space="categorical",
        action_value_key=keys.ACTION_VALUE,
        out_keys=[keys.ACTION, keys.ACTION_VALUE, keys.CHOSEN_ACTION_VALUE],
    )
    return TensorDictSequential(values, choice)


def value_and_gradients(loss: Tensor, agent: DeepQ) -> tuple[Tensor, ...]:
    return (loss.detach(), *torch.autograd.grad(loss, list(agent.learnt.parameters())))


def require_equal(agent: DeepQ, torchrl: LossModule, mine: TensorDictBase, theirs: TensorDictBase):
    """Hold `agent.loss` to TorchRL's on the same weights, with a target network that lags behind.

    TorchRL's loss shares the agent's weights, and both made their target networks of them.
    """
    draw = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for weight in agent.learnt.parameters():
            weight += 0.1 * torch.randn(weight.shape, generator=draw)
    torchrl.make_value_estimator(ValueEstimators.TD0, gamma=agent.gamma)
    expected = value_and_gradients(torchrl(theirs)["loss"], agent)
    actual = value_and_gradients(agent.loss(mine), agent)
    assert all(gradient.any() for gradient in expected)
    torch.testing.assert_close(actual, expected)


def every_ending() -> TensorDict:
    """Frames that end by termination, by truncation and not at all, over 1 to 3 steps."""
    batch = transitions(64, seed=3)
    done, terminated = batch["next", "done"], batch["next", "terminated"]
    assert terminated.any() and (done & ~terminated).any() and not done.all()
    assert set(batch[keys.STEPS_TO_NEXT_OBS].tolist()) == {1, 2, 3}
    return batch


def by_robot(batch: TensorDict) -> TensorDict:
    """The same frames with steps and endings for each robot, as DQNLoss wants them."""
    shape = batch["next", keys.REWARD].shape
    frames = batch.clone()
    frames[keys.STEPS_TO_NEXT_OBS] = batch[keys.STEPS_TO_NEXT_OBS][:, None, None].expand(shape)
    frames["next", ROBOTS_DONE] = batch["next", "done"][:, None].expand(shape)
    frames["next", ROBOTS_TERMINATED] = batch["next", "terminated"][:, None].expand(shape)
    return frames


def hold_to_dqn_loss(agent: DeepQ, double: bool, loss: str) -> None:
    torchrl = DQNLoss(
        actor(agent.network),
        loss_function=loss,
        delay_value=True,
        double_dqn=double,
        action_space="categorical",
    )
    torchrl.set_keys(
        action=keys.ACTION,
        action_value=keys.ACTION_VALUE,
        value=keys.CHOSEN_ACTION_VALUE,
        reward=keys.REWARD,
        done=ROBOTS_DONE,
        terminated=ROBOTS_TERMINATED,
    )
    batch = every_ending()
    require_equal(agent, torchrl, batch, by_robot(batch))


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("loss", LOSSES)
def test_robots_losses_equal_torchrl(double: bool, loss: str) -> None:
    hold_to_dqn_loss(make_agent(double=double, loss=loss), double, loss)


@pytest.mark.parametrize("learner", ["vdn", "qmix"])
@pytest.mark.parametrize("loss", LOSSES)
def test_mixed_losses_equal_torchrl(learner: str, loss: str) -> None:
    """Without double, which TorchRL's loss does not have."""
    agent = make_learner(learner, "plan", double=False, loss=loss)
    mixed_of = [keys.CHOSEN_ACTION_VALUE, *([keys.STATE] if isinstance(agent, Qmix) else [])]
    mixer = agent.learnt[MIXER].get_submodule("module")
    torchrl = QMixerLoss(
        actor(agent.network),
        TensorDictModule(mixer, in_keys=mixed_of, out_keys=[keys.TEAM_VALUE]),
        loss_function=loss,
        action_space="categorical",
    )
    torchrl.set_keys(
        action=keys.ACTION,
        action_value=keys.ACTION_VALUE,
        local_value=keys.CHOSEN_ACTION_VALUE,
        global_value=keys.TEAM_VALUE,
        reward="reward",
    )
    batch = every_ending()
    draw = torch.Generator().manual_seed(1)
    for frames in (batch, batch["next"]):
        frames[keys.STATE] = (torch.rand(64, *STATE_SHAPE, generator=draw) < 0.5).float()
    team = batch["next", keys.REWARD][:, :1].expand(64, 2, 1)  # reward=team: the same for all
    batch["next", keys.REWARD] = team
    theirs = batch.clone()
    theirs["next", "reward"] = team[:, 0]
    require_equal(agent, torchrl, batch, theirs)


class NeverEnds(Iql):
    """A planted defect: it bootstraps past a terminated step."""

    def loss(self, frames):
        frames["next", "terminated"] = torch.zeros_like(frames["next", "terminated"])
        return super().loss(frames)


class EndsWhenCutOff(Iql):
    """A planted defect: a truncated episode has no later value."""

    def loss(self, frames):
        frames["next", "terminated"] = frames["next", "done"]
        return super().loss(frames)


@pytest.mark.parametrize("defect", [NeverEnds, EndsWhenCutOff])
def test_planted_defects_of_the_target_are_seen(defect: type[Iql]) -> None:
    encoder = make_encoder()
    wrong = defect(encoder, make_comm("plan", encoder), **IQL)
    with pytest.raises(AssertionError, match="not close"):
        hold_to_dqn_loss(wrong, double=True, loss="smooth_l1")
