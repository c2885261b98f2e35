"""Every level of conf/planner holds the contract of planners, and finishes houses of rooms."""

from itertools import product

import pytest

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.config.levels import rooms
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.settings import HouseOrder
from marl_clean.testing import check_planner
from tests.families import family

pytestmark = pytest.mark.usefixtures("unchecked")

LEVELS = rooms()["planner"]
VARIANTS = [
    "planner=nearest_unknown planner.assignment=greedy planner.ties=rotated",
    "planner=nearest_unknown planner.assignment=hungarian planner.ties=straight",
    "planner=nearest_unknown planner.ties=straight planner.wall_prior=true",
]
PLANNERS = [f"planner={level}" for level in LEVELS] + VARIANTS
FINISHING = [planner for planner in PLANNERS if planner != "planner=random"]
SMALL = ["house.rows=[7, 10]", "house.cols=[7, 10]"]
each_planner = pytest.mark.parametrize("planner", PLANNERS)


@family("planner", PLANNERS, fast=[], usual=4)
def test_the_contract(planner: str) -> None:
    level, *settings = (text.partition("=")[2] for text in planner.split())
    names = (text.partition("=")[0].removeprefix("planner.") for text in planner.split()[1:])
    values = (value == "true" or value for value in settings)
    check_planner(level, finishes=planner in FINISHING, **dict(zip(names, values, strict=True)))


@family(
    ("planner", "sensor", "n_agents"),
    [*product(FINISHING, ["bump"], [1, 3]), *product(FINISHING, ["touch4"], [3])],
    fast=[],
    usual=6,
)
def test_no_house_is_finished_sooner_than_it_can_be(
    planner: str, sensor: str, n_agents: int
) -> None:
    """And each is finished; houses with rooms, which those of the contract have not."""
    settings = [f"env.sensor={sensor}", f"env.n_agents={n_agents}"]
    cfg = compose_config([*SMALL, *planner.split(), *settings])
    records = evaluate(cfg, lambda env: build.make_planner(cfg, env), house_set="test", count=8)
    for record in records:
        assert record["T_100"] is not None and record["T_100"] >= record["bound_100"]


@each_planner
def test_a_label_names_what_is_not_the_default(planner: str) -> None:
    cfg = compose_config([*SMALL, *planner.split()])
    houses = build.held_out_houses(cfg, "test", 6)
    env = build.make_env(cfg, houses, num_envs=6, house_order=HouseOrder.FIXED)
    label = build.make_planner(cfg, env).label
    chosen = [setting.partition("=")[2] for setting in planner.split()]
    chosen = ["wall_prior" if choice == "true" else choice for choice in chosen]
    assert label == "+".join(chosen)
