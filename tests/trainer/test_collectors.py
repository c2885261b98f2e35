"""Processes that collect: the same worlds, exact resumption, and one line when one of them dies."""

import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.schema import instantiate
from marl_clean.errors import BadInput
from marl_clean.logger.csv import Csv
from marl_clean.settings import Collectors
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._collectors import InTheTrainer, Moment
from marl_clean.trainer._frames import check_frames
from marl_clean.trainer._remote import Processes
from marl_clean.trainer._share import share_maker
from marl_clean.trainer._warm_start import WarmStart
from tests.trainer.test_cleaning import SETTINGS
from tests.trainer.test_off_policy import assert_same_results

pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")

TWO = ["trainer.collectors.backend=process", "trainer.collectors.num=2"]
OFF_POLICY = [*SETTINGS, "trainer.total_frames=384", "encoder.hidden=[16]", *TWO]
ON_POLICY = [
    *(setting for setting in SETTINGS if not setting.startswith("trainer.")),
    "agent=ippo",
    "trainer=on_policy",
    "encoder.hidden=[16]",
    "trainer.total_frames=384",
    "trainer.frames_per_batch=64",
    "trainer.minibatch_frames=32",
    "trainer.log_interval_frames=128",
    "trainer.eval_interval_frames=192",
    "trainer.curriculum_stages=2",
    "trainer.imitate=nearest_unknown",
    "trainer.imitate_frames_share=0.4",
    "trainer.imitate_states=learner",
    "comm=plan",
    *TWO,
]


class Stopper(Csv):
    """Sends SIGINT to this process and to those that collect, as Ctrl-C does, with a row."""

    def log(self, frames, values) -> None:
        super().log(frames, values)
        if 100 < frames < 200:
            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)


class Killer(Csv):
    """Kills a process that collects."""

    def log(self, frames, values) -> None:
        super().log(frames, values)
        os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)


def assert_no_process_left() -> None:
    """A process that is killed may take a moment to be gone."""
    end = time.monotonic() + 10
    while (left := multiprocessing.active_children()) and time.monotonic() < end:
        time.sleep(0.1)
    assert not left


def train(folder: Path, settings: list[str], logger: type[Csv] = Csv) -> None:
    folder.mkdir(exist_ok=True)
    cfg = compose_config(settings)
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    instantiate(cfg.trainer).train(
        build.ready_for(agent, env),
        agent,
        lambda policy: {"T_100": 1.0},
        [logger(folder)],
        folder,
        make_share=share_maker(cfg),
    )


@pytest.mark.long
@pytest.mark.parametrize("settings", [ON_POLICY], ids=["on policy"])
def test_a_run_with_processes_is_resumed_exactly(tmp_path, settings):
    train(tmp_path / "whole", settings)
    with pytest.raises(SystemExit) as stopped:
        train(tmp_path / "torn", settings, Stopper)
    assert stopped.value.code == 130
    assert_no_process_left()
    assert Checkpoints(tmp_path / "torn" / FOLDER).newest("state") is not None
    train(tmp_path / "torn", settings)
    assert_same_results(tmp_path / "torn", tmp_path / "whole")
    assert torch.get_num_threads() == 1


@pytest.mark.slow
def test_actors_of_ray_collect_what_processes_do(tmp_path):
    pytest.importorskip("ray")
    train(tmp_path / "processes", OFF_POLICY)
    train(tmp_path / "actors", [*OFF_POLICY, "trainer.collectors.backend=ray"])
    assert_same_results(tmp_path / "actors", tmp_path / "processes")


@pytest.mark.long
def test_a_process_that_dies_is_one_line(tmp_path):
    with pytest.raises(BadInput, match=r"^trainer\.collectors: a process that collects.*resumes"):
        train(tmp_path / "run", OFF_POLICY, Killer)
    assert_no_process_left()


def demonstrating(cfg: DictConfig) -> tuple:
    """Env and learner whose actions are a planner's, so that nothing depends on torch's stream."""
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    return build.ready_for(agent, env), agent


@pytest.mark.long
def test_processes_step_the_worlds_that_one_loop_steps():
    cfg = compose_config([*OFF_POLICY, "agent.eps_init=0", "agent.eps_end=0", "env.n_agents=3"])
    imitate, moment = ("nearest_unknown", 384.0, "planner"), Moment(0, 384, 0.0, 7)
    env, agent = demonstrating(cfg)
    env.base_env.open_houses(7)
    one = InTheTrainer(env, WarmStart(agent, env, *imitate), 128)
    two = Processes(*demonstrating(cfg), share_maker(cfg), imitate, 7, 2, 128)
    try:
        for _ in range(3):
            expected, block = one.block(moment), two.block(moment)
            assert block.shape == expected.shape == (8, 16)
            for key in (keys.OBSERVATION, keys.ACTION, ("next", keys.REWARD), ("next", keys.DONE)):
                assert torch.equal(block[key], expected[key]), key
        assert two.progress() == pytest.approx(one.progress())
    finally:
        two.shutdown()
        one.shutdown()


FITTING = {
    "frames_per_batch": 64,
    "buffer_frames": 64,
    "batch_frames": 64,
    "window_frames": 8,
}


@pytest.mark.parametrize(
    ("backend", "num", "message"),
    [
        ("none", 2, "num=2: needs trainer.collectors.backend=process or ray"),
        ("process", 3, "num=3: must divide env.num_envs=8; valid: 1, 2, 4, 8"),
        ("ray", 16, "num=16: must divide env.num_envs=8"),
    ],
)
def test_collectors_that_do_not_fit_are_bad_input(backend, num, message):
    with pytest.raises(BadInput) as error:
        check_frames({**FITTING, "collectors": Collectors(backend, num)}, 8)
    assert message in str(error.value)
    check_frames({**FITTING, "collectors": Collectors("process", 4)}, 8)


@pytest.mark.parametrize("setting", ["backend=proces", "num=0", "num=1.5", "num=true", "number=2"])
def test_a_wrong_value_names_the_key(setting):
    with pytest.raises(BadInput, match=r"^trainer\.collectors\.(backend|num|number): "):
        compose_config([f"trainer.collectors.{setting}"])


def test_the_default_leaves_the_hash_of_a_config_what_it_was():
    before = compose_config([])
    assert before.trainer.collectors == {"backend": "none", "num": 1}
    chosen = compose_config(["trainer.collectors.backend=process"])
    assert config_hash(chosen) != config_hash(before)
    del before.trainer.collectors
    assert config_hash(compose_config([])) == config_hash(before)
