"""What every scripted policy keeps to, whatever its plan: found by globbing conf/planner."""

from itertools import product
from pathlib import Path

import pytest
import torch

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.keys import ACTION
from marl_clean.settings import HouseOrder
from marl_clean.world.state import State

LEVELS = sorted(path.stem for path in Path(__file__).parents[2].glob("conf/planner/*.yaml"))
VARIANTS = [
    "planner=nearest_unknown planner.assignment=greedy planner.ties=rotated",
    "planner=nearest_unknown planner.assignment=hungarian planner.ties=straight",
    "planner=nearest_unknown planner.ties=straight planner.wall_prior=true",
]
PLANNERS = [f"planner={level}" for level in LEVELS] + VARIANTS
SENSORS = ["bump", "touch4"]
SMALL = ["house.rows=[7, 10]", "house.cols=[7, 10]"]
each_planner = pytest.mark.parametrize("planner", PLANNERS)


def config_of(planner: str, *settings: str):
    return compose_config([*SMALL, *planner.split(), *settings])


def env_of(cfg, first: int = 0, num_envs: int = 6):
    """Test houses `first`, `first + 1`, ...: house i is environment i."""
    houses = build.held_out_houses(cfg, "test", 6)
    return build.make_env(
        cfg, houses, num_envs=num_envs, first_env=first, house_order=HouseOrder.FIXED
    )


def actions_of(cfg, first: int = 0, num_envs: int = 3, steps: int = 30) -> torch.Tensor:
    """What the planner does, episode after episode: [env, step, agent]."""
    env = env_of(cfg, first, num_envs)
    rollout = env.rollout(steps, build.make_planner(cfg, env), break_when_any_done=False)
    return rollout[ACTION]


@pytest.mark.slow
@each_planner
def test_actions_are_valid_and_a_batch_is_each_world_alone(planner: str) -> None:
    cfg = config_of(planner, "env.n_agents=3", "env.max_steps=22")  # a second episode begins
    together = actions_of(cfg)
    assert together.dtype == torch.int64 and together.shape == (3, 30, 3)
    assert ((together >= 0) & (together < 4)).all()
    alone = torch.cat([actions_of(cfg, first, 1) for first in range(3)])
    assert torch.equal(together, alone)


def records_of(planner: str, count: int, *settings: str):
    cfg = config_of(planner, *settings)
    return evaluate(cfg, lambda env: build.make_planner(cfg, env), house_set="test", count=count)


HIDDEN = {"blocked", "piece", "visited", "num_visited", "num_free", "furniture_moves", "house"}


@each_planner
@pytest.mark.parametrize("sensor", SENSORS)
def test_the_truth_is_not_read(planner: str, sensor: str) -> None:
    """With all that robots cannot know overwritten, and asked twice, the plan is the same."""
    cfg = config_of(planner, "env.n_agents=2", f"env.sensor={sensor}")
    env = env_of(cfg)
    policy, td = build.make_planner(cfg, env), env.reset()
    for _ in range(25):
        action = policy(td)[ACTION].clone()
        base, truth = env.base_env, env.base_env.state
        scrambled = {
            name: ~value if value.dtype == torch.bool else value + 1
            for name, value in truth.tensors().items()
            if name in HIDDEN
        }
        base.state = State(**{**truth.tensors(), **scrambled})
        assert torch.equal(policy(td)[ACTION], action)
        base.state = truth
        td = env.step_mdp(env.step(td))


FINISHING = [planner for planner in PLANNERS if planner != "planner=random"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planner", "sensor", "n_agents"),
    [
        *product([f"planner={name}" for name in LEVELS if name != "random"], SENSORS, [1, 3]),
        *product(VARIANTS, ["bump"], [3]),
    ],
)
def test_every_house_is_finished(planner: str, sensor: str, n_agents: int) -> None:
    for record in records_of(planner, 20, f"env.sensor={sensor}", f"env.n_agents={n_agents}"):
        assert record["T_100"] is not None and record["T_100"] >= record["bound_100"]


@pytest.mark.slow
@pytest.mark.parametrize("planner", FINISHING)
@pytest.mark.parametrize("memory", ["private", "merged"])
def test_robots_with_maps_of_their_own_finish_too(planner: str, memory: str) -> None:
    records = records_of(planner, 6, f"env.memory={memory}", "env.max_steps=400")
    assert all(record["T_100"] is not None for record in records)


@pytest.mark.parametrize("planner", FINISHING)
def test_a_house_known_by_heart_is_cleaned_all_the_same(planner: str) -> None:
    for record in records_of(planner, 6, "env.knowledge=memorised"):
        assert record["T_100"] is not None


@each_planner
def test_a_label_names_what_is_not_the_default(planner: str) -> None:
    cfg = config_of(planner)
    label = build.make_planner(cfg, env_of(cfg)).label
    chosen = [setting.partition("=")[2] for setting in planner.split()]
    chosen = ["wall_prior" if choice == "true" else choice for choice in chosen]
    assert label == "+".join(chosen)
