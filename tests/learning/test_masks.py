"""Masked actions are never taken, never in targets, and never make a loss infinite."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical, Composite
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import keys
from marl_clean.learning.agent import Agent
from marl_clean.learning.joint_actions import decode_joint, joint_mask
from marl_clean.learning.symmetry import (
    NUM_SYMMETRIES,
    rotate_action,
    rotate_masks_in_eighths,
)
from marl_clean.testing import check_agent
from tests.agent.parts import LEARNERS, STATE_SHAPE, make_learner, transitions
from tests.families import family

COUNT = 200
ON_POLICY = ("pqn", "ippo", "mappo")


def make(level: str, **changes) -> Agent:
    comm = "none" if level == "central_dqn" else "plan"
    return make_learner(level, comm, mask_walls=True, **changes)


def masks(seed: int, count: int = COUNT) -> torch.Tensor:
    """Random masks, another for each robot, each with an action left."""
    draw = torch.Generator().manual_seed(seed)
    mask = torch.rand(count, 2, 4, generator=draw) < 0.4
    left = torch.randint(4, (count, 2, 1), generator=draw)
    return mask.scatter(-1, left, True)


def batch() -> TensorDict:
    """Frames, in some of which a masked action was taken."""
    frames = transitions(COUNT)
    frames[keys.ACTION_MASK], frames["next", keys.ACTION_MASK] = masks(1), masks(2)
    for part in (frames, frames["next"]):
        part[keys.STATE] = torch.rand(COUNT, *STATE_SHAPE) < 0.5
    assert not allowed(frames).all()
    return frames


def allowed(frames: TensorDict) -> torch.Tensor:
    return frames[keys.ACTION_MASK].gather(-1, frames[keys.ACTION].unsqueeze(-1)).squeeze(-1)


def acted(agent: Agent, explores: bool) -> TensorDict:
    shape = (COUNT, 2)
    spec = Composite(
        agents=Composite(action=Categorical(4, shape=shape), shape=shape), shape=(COUNT,)
    )
    policy = agent.exploration(spec) if explores else agent.policy()
    torch.manual_seed(3)
    kind = ExplorationType.RANDOM if explores else ExplorationType.DETERMINISTIC
    with torch.no_grad(), set_exploration_type(kind):
        return policy(batch().exclude("next", keys.ACTION))


@pytest.mark.parametrize("level", LEARNERS)
@pytest.mark.parametrize("progress", [0.0, 0.07, None])
def test_no_robot_takes_a_masked_action(level: str, progress: float | None) -> None:
    agent = make(level)
    if progress is not None:
        agent.anneal(progress)
    frames = acted(agent, explores=progress is not None)
    assert allowed(frames).all()
    assert frames[keys.ACTION].unique().tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("level", LEARNERS)
def test_a_masked_action_that_was_taken_gives_finite_losses(level: str) -> None:
    agent, frames = make(level), batch()
    if level in ON_POLICY:
        block = frames.view(20, 10)
        if level != "pqn":
            block[keys.LOG_PROB] = torch.rand(20, 10, 2).log()
        else:
            with torch.no_grad():
                block[keys.ACTION_VALUE] = agent.policy()(block.clone())[keys.ACTION_VALUE]
        frames = agent.estimate(block.select(*agent.learns_from)).flatten()
        assert frames[keys.VALUE_TARGET].abs().max() < 100
        assert allowed(frames).all()
    for _ in range(2):
        measured = agent.update(frames.clone())
        assert all(value.abs() < 1e3 for value in measured.values())
    assert all(weight.isfinite().all() for weight in agent.network.parameters())


@pytest.mark.parametrize("double", [True, False])
def test_targets_are_of_the_best_action_that_is_allowed(double: bool) -> None:
    agent = make("iql", double=double, dueling=False, loss="l2")
    frames = batch()
    head = agent.network.head
    with torch.no_grad():  # whatever is seen, actions are worth 0 to 3
        for network in (agent.network, agent.target["network"]):
            network.head.weight.zero_()
            network.head.bias.copy_(torch.arange(4.0))
    assert head.bias.tolist() == [0.0, 1.0, 2.0, 3.0]
    best = torch.where(frames["next", keys.ACTION_MASK], torch.arange(4.0), -1.0).amax(-1)
    continues = 1.0 - frames["next", keys.TERMINATED].float()
    discount = agent.gamma ** frames[keys.STEPS_TO_NEXT_OBS].unsqueeze(-1)
    target = frames["next", keys.REWARD].squeeze(-1) + discount * continues * best
    expected = (frames[keys.ACTION] - target).square().mean()
    torch.testing.assert_close(agent.update(frames)["loss"], expected)


def test_a_joint_action_is_masked_where_a_part_of_it_is() -> None:
    mask = masks(5, count=7)
    joint = joint_mask(mask)
    parts = decode_joint(torch.arange(16), 2)
    for frame in range(7):
        for number, (first, second) in enumerate(parts.tolist()):
            both = mask[frame, 0, first] & mask[frame, 1, second]
            assert joint[frame, number] == both


def test_masks_rotate_with_the_actions() -> None:
    (before,) = [masks(6, count=NUM_SYMMETRIES)]
    (after,) = rotate_masks_in_eighths([before])
    for element in range(NUM_SYMMETRIES):
        for action in range(4):
            to = rotate_action(torch.tensor(action), element)
            assert torch.equal(after[element, :, to], before[element, :, action])


def test_rotated_frames_are_masked_as_they_were() -> None:
    agent, frames = make("iql", augment=True), batch()
    assert agent.update(frames)["loss"] < 100


def test_the_advantages_of_dueling_are_averaged_over_all_actions() -> None:
    plain, hiding = make_learner("iql", "plan", mask_walls=False), make("iql")
    hiding.network.load_state_dict(plain.network.state_dict())
    frames = batch()
    values, shown = (agent.values(agent.network, frames) for agent in (plain, hiding))
    mask = frames[keys.ACTION_MASK]
    assert torch.equal(shown[mask], values[mask])
    assert (shown[~mask] == torch.finfo(torch.float32).min).all()


@family("level", ["iql", "qmix", "central_dqn", "pqn", "ippo"], fast=["iql"])
def test_the_contract_where_walls_are_masked(level: str) -> None:
    check_agent(level, precision="float32", mask_walls=True)
