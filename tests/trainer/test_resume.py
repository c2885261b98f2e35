"""Every kind of run goes on exactly where it was stopped: on policy, mixed, with a memory."""

import signal
from pathlib import Path

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

from marl_clean import build
from marl_clean.channel.delayed import Delayed
from marl_clean.learning.agent import Agent
from marl_clean.logger.csv import Csv
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer.base import Trainer
from marl_clean.trainer.off_policy import OffPolicy
from marl_clean.trainer.on_policy import OnPolicy
from tests.agent.parts import make_agent, make_encoder, make_learner
from tests.families import family
from tests.trainer.test_off_policy import SETTINGS, Signalling, assert_same_results

pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")

ON_POLICY = {
    "total_frames": 480,
    "frames_per_batch": 96,
    "epochs": 2,
    "minibatch_frames": 48,
    "log_interval_frames": 90,
    "eval_interval_frames": 192,
    "checkpoint_interval_frames": 128,
    "select_by": "return",
}


def with_memory() -> tuple[Trainer, Agent]:
    channels = {"delayed": Delayed(1, False, (32,))}
    agent = make_agent("plan", encoder=make_encoder(memory="gru"), channels=channels)
    return OffPolicy(**SETTINGS, window_frames=3), agent


KINDS = {
    "on policy": lambda: (OnPolicy(**ON_POLICY), make_learner("mappo", "plan")),
    "pqn": lambda: (
        OnPolicy(**ON_POLICY),
        make_learner("pqn", "commnet", gamma_end=0.5, gamma_rises_with="successes"),
    ),
    "a critic with memory": lambda: (
        OnPolicy(**ON_POLICY),
        make_learner("ippo", "plan", critic_memory="gru", entropy_coeff_end=0.0),
    ),
    "mixed": lambda: (OffPolicy(**SETTINGS), make_learner("vdn", "commnet")),
    "with memory": with_memory,
    "on policy with memory": lambda: (
        OnPolicy(**ON_POLICY),
        make_learner("ippo", "none", encoder=make_encoder(memory="gru")),
    ),
}


def train(folder: Path, kind: str, at: int = -1) -> None:
    folder.mkdir(exist_ok=True)
    trainer, agent = KINDS[kind]()
    env = TransformedEnv(Signalling(at, signal.SIGTERM), Compose())
    torch.manual_seed(0)
    trainer.train(
        build.ready_for(agent, env), agent, lambda policy: {"return": 0.5}, [Csv(folder)], folder
    )


@pytest.mark.slow
@family("kind", KINDS, fast=[], usual=2)
def test_an_interrupted_run_goes_on_exactly(tmp_path, kind):
    train(tmp_path / "whole", kind)
    with pytest.raises(SystemExit):
        train(tmp_path / "torn", kind, at=16)
    assert Checkpoints(tmp_path / "torn" / FOLDER).newest("state") is not None
    train(tmp_path / "torn", kind)
    assert_same_results(tmp_path / "torn", tmp_path / "whole")
