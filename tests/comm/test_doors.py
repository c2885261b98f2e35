"""The probe: schemes that talk open the right door, silent ones guess."""

from contextlib import suppress
from pathlib import Path

import pytest
import torch
from torchrl.envs import TransformedEnv

from marl_clean.channel.delayed import Delayed
from marl_clean.learning.agent import Agent
from marl_clean.logger.csv import Csv
from marl_clean.trainer.base import Trainer
from marl_clean.trainer.off_policy import OffPolicy
from marl_clean.trainer.on_policy import OnPolicy
from tests.agent.parts import make_agent, make_learner
from tests.comm.contract import LEVELS, make
from tests.comm.doors import doors_for, share_right
from tests.families import family

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread", "unchecked")]

FRAMES = 6_144
EVALUATIONS = 16  # in a training, which ends where one finds that it has learnt
ENOUGH = 0.97
WORLDS = 128  # on policy: many worlds and few updates, whose cost is in their number
# Off policy: worlds, steps between learning, frames an update, learning rate.
QUICK = (64, 4, 128, 5e-3)
CAREFUL = (16, 6, 64, 2e-3)  # for those that miss the door with one seed in three otherwise
SILENT = ["none", "zeroed", "delta", "lend", "patch"]
FROM_MAPS = ["autoencoder", "target"]  # there are none
TALKING = [level for level, _ in LEVELS if level not in (*SILENT, *FROM_MAPS)]


@pytest.mark.long
@pytest.mark.parametrize("learner", ["vdn", "qmix"])
def test_mixers_learn_to_talk_too(tmp_path, learner):
    pace = CAREFUL if learner == "qmix" else QUICK
    agent = make_learner(learner, "plan", **of_off_policy(pace))
    train_off_policy(agent, tmp_path, hold=1, pace=pace)
    assert share_right(agent, hold=1) > 0.95


@pytest.mark.long
@pytest.mark.parametrize(("learner", "comm"), [("ippo", "plan"), ("mappo", "commnet")])
def test_policies_that_draw_learn_to_talk_too(tmp_path, learner, comm):
    agent = make_learner(learner, comm, gamma=0.0, lr=5e-3, lr_end=5e-3)
    train_on_policy(agent, tmp_path, hold=1)
    assert share_right(agent, hold=1) > 0.95


@pytest.mark.long
def test_lambda_returns_of_the_last_block_teach_to_talk_too(tmp_path):
    agent = make_learner("pqn", "plan", gamma=0.0, lr=3e-3, lr_end=3e-3, annealing_fraction=0.6)
    train_on_policy(agent, tmp_path, hold=1, worlds=32, frames=8_192)  # more would take more frames
    assert share_right(agent, hold=1) > 0.95


@pytest.mark.long
def test_a_policy_that_draws_guesses_in_silence(tmp_path):
    agent = make_learner("ippo", "none", gamma=0.0, lr=5e-3, lr_end=5e-3)
    train_on_policy(agent, tmp_path, hold=1)
    assert 0.4 <= share_right(agent, hold=1) <= 0.6


@pytest.mark.long
def test_a_policy_that_draws_hears_late_messages(tmp_path):
    channels = {"delayed": Delayed(1, False, make("commnet", hidden=24).message_dims)}
    agent = make_learner("ippo", "commnet", gamma=0.0, lr=5e-3, lr_end=5e-3, channels=channels)
    train_on_policy(agent, tmp_path, hold=2)
    assert share_right(agent, hold=2) > 0.95


def right_after_training(folder: Path, comm: str, hold: int, **changes) -> float:
    pace = CAREFUL if comm in ("dial", "expocomm") else QUICK
    agent = make_agent(comm, **of_off_policy(pace), **changes)
    train_off_policy(agent, folder, hold, pace)
    return share_right(agent, hold)


def of_off_policy(pace: tuple[int, int, int, float]) -> dict[str, float]:
    lr = pace[-1]
    return {"gamma": 0.0, "lr": lr, "lr_end": lr, "n_steps": 1, "annealing_fraction": 0.6}


def train_on_policy(
    agent: Agent, folder: Path, hold: int, worlds: int = WORLDS, frames: int = FRAMES
) -> None:
    trainer = OnPolicy(
        total_frames=frames,
        frames_per_batch=3 * worlds,  # so that rows begin while a message is under way, too
        epochs=4,
        minibatch_frames=3 * worlds // 4,
        log_interval_frames=frames,
        eval_interval_frames=frames // EVALUATIONS,
        checkpoint_interval_frames=frames,
        select_by="return",
    )
    run(trainer, agent, folder, doors_for(agent, hold, worlds), hold)


class Solved(Exception):
    """Ends a training whose robots take the open door already."""


def run(trainer: Trainer, agent: Agent, folder: Path, env: TransformedEnv, hold: int) -> None:
    """Train for all frames, or until an evaluation finds that the robots take the open door."""

    def evaluate(policy: object) -> dict[str, float]:
        with torch.random.fork_rng([]):
            if share_right(agent, hold) > ENOUGH:
                raise Solved
        return {"return": 0.0}

    torch.manual_seed(0)
    with suppress(Solved):
        trainer.train(env, agent, evaluate, [Csv(folder)], folder)


def train_off_policy(
    agent: Agent, folder: Path, hold: int, pace: tuple[int, int, int, float]
) -> None:
    worlds, steps, batch_frames, _ = pace
    frames = FRAMES if pace is QUICK else 8_192
    trainer = OffPolicy(
        total_frames=frames,
        frames_per_batch=worlds * steps,
        buffer_frames=5_000,
        batch_frames=batch_frames,
        replay_ratio=4.0,
        start_frames=300,
        log_interval_frames=frames,
        eval_interval_frames=frames // EVALUATIONS,
        checkpoint_interval_frames=frames,
        select_by="return",
        window_frames=4,
    )
    run(trainer, agent, folder, doors_for(agent, hold, worlds), hold)


@family("comm", TALKING, fast=[], usual=["commnet"])
def test_who_talks_opens_the_right_door(tmp_path, comm):
    scheme = make(comm)
    hold = 1 + max(scheme.delay_steps, bool(scheme.remembers))  # what is remembered is sent later
    assert right_after_training(tmp_path, comm, hold) > 0.95


@family("comm", SILENT, fast=[], usual=["zeroed"])
def test_who_is_silent_guesses(tmp_path, comm):
    """Even at a door that waits, where whatever crosses within a step or a step late would help."""
    assert 0.4 <= right_after_training(tmp_path, comm, hold=2) <= 0.6


@pytest.mark.long
def test_a_message_that_comes_a_step_late_helps_only_if_the_door_waits(tmp_path):
    late = {"steps": 1, "random": False, "message_dims": make("commnet", hidden=24).message_dims}
    for hold, right in ((1, False), (2, True)):
        folder = tmp_path / str(hold)
        folder.mkdir()
        channels = {"delayed": Delayed(**late)}
        share = right_after_training(folder, "commnet", hold, channels=channels)
        assert (share > 0.95) is right
