"""Larger houses are opened by success alone, and a run with a curriculum goes on exactly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_bank, smallest_first
from marl_clean.house.rooms import Rooms
from marl_clean.logger.csv import Csv
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._curriculum import Curriculum
from tests.trainer.killing import Killed, kill_after

pytestmark = pytest.mark.usefixtures("unchecked")

HOUSES = smallest_first(draw_bank(Rooms([5, 9], [5, 9]), 30, n_agents=2))


def env_of(count: int) -> CleaningEnv:
    """One world and `count` houses."""
    names = ("free", "furniture", "rows", "cols", "sources")
    return CleaningEnv(
        replace(HOUSES, **{name: getattr(HOUSES, name)[:count] for name in names}), num_envs=1
    )


def block(*worlds: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Ends of episodes: in each world and step `.` none, `+` finished, `-` cut."""
    done = torch.tensor([[end != "." for end in world] for world in worlds])
    return done, torch.tensor([[end == "+" for end in world] for world in worlds])


def stages_after(curriculum: Curriculum, *blocks: tuple[str, ...]) -> list[tuple[int, int]]:
    """The stage and the number of open houses after each block."""
    env = env_of(10)
    curriculum.open_houses(env)
    stages = []
    for worlds in blocks:
        curriculum.note(env, *block(*worlds))
        stages.append((curriculum.stage, env.num_open))
    return stages


def test_planted_successes_open_one_stage_after_the_other_and_then_no_more() -> None:
    blocks = [("+..+", ".+..")] * 5
    stages = stages_after(Curriculum(3, 0.75, 4), *blocks)
    assert stages == [(1, 4), (2, 7), (2, 7), (3, 10), (3, 10)]


def test_failures_open_nothing() -> None:
    assert stages_after(Curriculum(3, 0.75, 4), *[("-.-.", "..-+")] * 9)[-1] == (1, 4)
    assert stages_after(Curriculum(3, 0.75, 4), *[("....",)] * 9)[-1] == (1, 4)


def test_the_share_is_of_the_last_episodes_in_the_order_in_which_they_ended() -> None:
    """Of four the last three count: by world it were `+-+`, by time it is `-++`."""
    assert stages_after(Curriculum(2, 1.0, 2), ("+.+", ".-.")) == [(1, 5)]
    assert stages_after(Curriculum(2, 1.0, 2), ("-.+", ".+.")) == [(2, 10)]
    assert stages_after(Curriculum(2, 0.5, 4), ("-+",), ("-.",)) == [(1, 5), (1, 5)]
    assert stages_after(Curriculum(2, 0.5, 4), ("-+",), ("-+",)) == [(1, 5), (2, 10)]


@pytest.mark.parametrize(("stages", "count"), [(1, 1), (2, 7), (3, 7), (5, 30), (7, 7)])
def test_every_stage_opens_more_houses_and_the_last_all(stages: int, count: int) -> None:
    curriculum, env, opened = Curriculum(stages, 0.0, 1), env_of(count), []
    curriculum.check(env)
    for _ in range(stages):
        curriculum.open_houses(env)
        opened.append(env.num_open)
        curriculum.note(env, *block("-"))
    assert opened == sorted(set(opened)) and opened[-1] == count
    assert max(np.diff([0, *opened])) - min(np.diff([0, *opened])) <= 1


def test_more_stages_than_houses_are_refused() -> None:
    with pytest.raises(BadInput, match=r"curriculum_stages=4: .* valid: 1 to 3"):
        Curriculum(4, 0.9, 500).check(env_of(3))


@pytest.mark.slow
def test_houses_stand_in_the_order_of_their_size_and_are_the_same_ones() -> None:
    cfg = compose_config(["house=mixture", "train_houses=60", "trainer.curriculum_stages=3"])
    plain = build.training_houses(compose_config(["house=mixture", "train_houses=60"]))
    houses = build.training_houses(cfg)
    assert (np.diff(houses.free_cells) >= 0).all() and (np.diff(plain.free_cells) < 0).any()
    assert sorted(houses.sources) == sorted(plain.sources)
    for index in (0, 17, 59):
        other = plain.sources.index(houses.sources[index])
        assert (houses.free[index] == plain.free[other]).all()
        assert (houses.furniture[index] == plain.furniture[other]).all()
        assert (houses.rows[index], houses.cols[index]) == (plain.rows[other], plain.cols[other])


def test_only_open_houses_are_drawn_and_in_the_end_all() -> None:
    env = CleaningEnv(HOUSES, num_envs=600)
    for count in (1, 7, 30):
        env.open_houses(count)
        env.reset()
        assert set(env.state.house.tolist()) == set(range(count))
    with pytest.raises(BadInput, match="valid: 1 to 30"):
        env.open_houses(31)


def test_all_houses_open_is_the_draw_without_a_curriculum() -> None:
    env, other = (CleaningEnv(HOUSES, num_envs=50, seed=3) for _ in range(2))
    other.open_houses(5)
    other.open_houses(30)
    env.reset(), other.reset()
    assert torch.equal(env.state.house, other.state.house)


def test_the_number_of_open_houses_is_part_of_the_envs_state() -> None:
    env = CleaningEnv(HOUSES, num_envs=50, seed=3)
    env.open_houses(4)
    other = CleaningEnv(HOUSES, num_envs=50, seed=9)
    other.load_state_dict(env.state_dict())
    env.reset(), other.reset()
    assert other.num_open == 4
    assert torch.equal(env.state.house, other.state.house) and int(env.state.house.max()) < 4


SETTINGS = [
    "env.num_envs=8",
    "env.stuck_after=12",
    "house.rows=[4,8]",
    "house.cols=[4,8]",
    "train_houses=20",
    "trainer.total_frames=768",
    "trainer.frames_per_batch=64",
    "trainer.batch_frames=16",
    "trainer.replay_ratio=0.25",
    "trainer.start_frames=64",
    "trainer.buffer_frames=300",
    "trainer.log_interval_frames=128",
    "trainer.eval_interval_frames=768",
    "trainer.checkpoint_interval_frames=192",
    "trainer.curriculum_stages=3",
    "trainer.curriculum_promote_at=0.1",
    "trainer.curriculum_window_episodes=12",
]


def train(folder: Path, die_after: int | None = None) -> CleaningEnv:
    folder.mkdir(exist_ok=True)
    cfg = compose_config(SETTINGS)
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    if die_after is not None:
        kill_after(env, die_after)
    trainer = instantiate(cfg.trainer)
    trainer.train(env, agent, lambda policy: {"T_100": 1.0}, [Csv(folder)], folder)
    return env.base_env


@pytest.mark.long
def test_a_killed_run_goes_on_in_its_stage_exactly(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    assert train(tmp_path / "whole").num_open > 7
    for die_after in (40, 46, 37):
        with pytest.raises(Killed):
            train(tmp_path / "killed", die_after)
    train(tmp_path / "killed")
    torch.set_num_threads(before)
    rows = [(tmp_path / name / "metrics.csv").read_text() for name in ("whole", "killed")]
    assert rows[0] == rows[1]
    header, *lines = rows[0].splitlines()
    column = header.split(",").index("stage")
    stages = [int(line.split(",")[column]) for line in lines]
    assert stages[0] == 1 and stages[-1] > 1 and stages == sorted(stages)
    whole, killed = (
        Checkpoints(tmp_path / name / FOLDER).newest("final").tree for name in ("whole", "killed")
    )
    assert all(torch.equal(weight, killed[name]) for name, weight in whole.items())
