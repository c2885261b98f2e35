"""The training loop on the real worlds: interrupted, it goes on exactly."""

import pytest
import torch

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.logger.csv import Csv
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._collecting import CarriedCollector
from marl_clean.trainer.off_policy import OffPolicy
from tests.families import family
from tests.trainer.killing import Killed, kill_after

pytestmark = pytest.mark.usefixtures("unchecked")

SETTINGS = [
    "env.num_envs=8",
    "env.stuck_after=12",
    "house.rows=[5,7]",
    "house.cols=[5,8]",
    "train_houses=20",
    "trainer.frames_per_batch=64",
    "trainer.batch_frames=16",
    "trainer.replay_ratio=0.5",
    "trainer.start_frames=64",
    "trainer.buffer_frames=300",
    "trainer.log_interval_frames=128",
    "trainer.eval_interval_frames=256",
    "trainer.checkpoint_interval_frames=96",
]


def train(folder, overrides, die_after: int | None = None) -> None:
    folder.mkdir(exist_ok=True)
    cfg = compose_config([*SETTINGS, *overrides])
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    shape = env.observation_spec[keys.OBSERVATION].shape[2:]
    encoder = build.make_encoder(cfg, shape)
    comm = build.make_comm(cfg.comm, encoder.out_features, shape)
    agent = instantiate(cfg.agent, encoder=encoder, comm=comm)
    if die_after is not None:
        kill_after(env, die_after)
    trainer = instantiate(cfg.trainer)
    assert isinstance(trainer, OffPolicy)
    trainer.train(env, agent, lambda policy: {"T_100": 1.0}, [Csv(folder)], folder)


@family(
    "overrides",
    [
        ["trainer.total_frames=384"],
        ["trainer.total_frames=384", "env.memory=merged", "env.n_agents=3", "agent.augment=true"],
        [
            *("trainer.total_frames=384", "env.memory=private", "env.shaping=0.5"),
            *("env.collision_pays=-1", "env.paid_by=team_map", "env.robots_shown=false"),
            "env.knowledge=[memorised,unknown]",
        ],
        ["trainer.total_frames=384", "comm=lend", "env.memory=private", "env.robots_noted=true"],
        ["trainer.total_frames=384", "comm=autoencoder", "env.memory=private", "comm.sure=0.3"],
    ],
    fast=[],
    usual=2,
    ids=["shared", "merged", "shaped", "lent", "read"],
)
def test_a_killed_run_ends_as_the_uninterrupted_one(tmp_path, overrides):
    train(tmp_path / "whole", overrides)
    for die_after in (29, 20):  # states of 192 and 320 frames go on, each between two rows
        with pytest.raises(Killed):
            train(tmp_path / "killed", overrides, die_after=die_after)
    train(tmp_path / "killed", overrides)
    rows = [(tmp_path / name / "metrics.csv").read_text() for name in ("whole", "killed")]
    assert rows[0] == rows[1]
    shaped = any("shaping" in override for override in overrides)
    assert ("shaping" in rows[0]) == ("collision," in rows[0]) == shaped
    whole, killed = (
        Checkpoints(tmp_path / name / FOLDER).newest("final").tree for name in ("whole", "killed")
    )
    assert all(torch.equal(weight, killed[name]) for name, weight in whole.items())


@pytest.mark.slow
def test_a_step_carried_by_an_earlier_version_goes_on() -> None:
    """It held nothing of what robots had earned, which was no observation then."""
    first, other = (
        CarriedCollector(
            build.make_env(compose_config(SETTINGS)), frames_per_batch=64, total_frames=-1
        )
        for _ in range(2)
    )
    next(iter(first))
    state = first.state().exclude(keys.OWN_REWARD, (keys.AGENTS, "info"))
    other.restore(state.clone())
    for key in state.keys(True, True):
        assert torch.equal(other.state()[key], state[key]), key
    block = next(iter(other))
    assert block[keys.OBSERVATION].isfinite().all() and block[keys.OWN_REWARD].any()
