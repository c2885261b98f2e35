"""A mixture: which part a seed picks, how often, and whose house it then is."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import chisquare

from marl_clean import build, cli
from marl_clean.config.compose import compose_config
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.evaluation.evaluator import measure_planner
from marl_clean.house.base import Houses, draw_bank, draw_houses
from marl_clean.house.drawn import Drawn
from marl_clean.house.mixture import Mixture
from marl_clean.house.open import Open
from marl_clean.house.rooms import Rooms
from marl_clean.settings import LARGEST_SIDE, HouseOrder
from tests.families import family

SIDES = [[5, 6], [8, 9], [12, 14]]
SEEDS = range(400)


def size_class(rows: int) -> int:
    return next(index for index, (low, high) in enumerate(SIDES) if low <= rows <= high)


@pytest.mark.slow
def test_a_seed_gives_one_house_whatever_else_is_drawn() -> None:
    mixture = Mixture(SIDES, ["rooms", "open"], plans=["apartment"], plans_share=0.3)
    together = [mixture.layout(seed) for seed in SEEDS]
    for seed in (7, 3, 399):
        alone = Mixture(SIDES, ["rooms", "open"], plans=["apartment"], plans_share=0.3).layout(seed)
        assert np.array_equal(alone.free, together[seed].free)
        assert alone.source == together[seed].source


@pytest.mark.slow
def test_a_house_is_the_one_that_its_part_alone_would_draw() -> None:
    mixture = Mixture(SIDES, ["rooms", "single_room", "cluttered", "open"])
    single = {"largest_room": LARGEST_SIDE**2, "divide": 0.0}
    cluttered = {"cells_per_piece": [5, 9], "piece_sides": [1, 2]}
    kinds = set()
    for seed in SEEDS:
        plan = mixture.layout(seed, draw=seed % 3)
        sides = SIDES[size_class(plan.free.shape[0])]
        parts = [Rooms(sides, sides, **settings) for settings in ({}, single, cluttered)]
        parts.append(Open(sides, sides))
        same = [np.array_equal(part.layout(seed, draw=seed % 3).free, plan.free) for part in parts]
        assert any(same) and plan.source == seed
        kinds |= {index for index, equal in enumerate(same) if equal}
    assert kinds == {0, 1, 2, 3}


@pytest.mark.slow
def test_margins_are_blocked_cells_around_the_same_house() -> None:
    plain = Mixture(SIDES, ["rooms", "open"], plans=["apartment"], plans_share=0.2)
    inside = Mixture(
        SIDES, ["rooms", "open"], [[0, 0], [2, 5]], plans=["apartment"], plans_share=0.2
    )
    widths, without = [], 0
    for seed in SEEDS:
        house, around = plain.layout(seed), inside.layout(seed)
        rows, cols = house.free.shape
        more = around.free.shape[0] - rows, around.free.shape[1] - cols
        without += more == (0, 0)
        if house.source == "apartment":
            assert more == (0, 0)
        elif more != (0, 0):
            placed = np.argwhere(around.free).min(0) - np.argwhere(house.free).min(0)
            widths += [*placed, *(more - placed)]
            again = np.pad(
                house.free,
                [(width, all_ - width) for width, all_ in zip(placed, more, strict=True)],
            )
            assert np.array_equal(again, around.free)
    assert set(widths) == {2, 3, 4, 5}
    assert without == pytest.approx(400 * (0.2 + 0.8 / 2), abs=50)


@pytest.mark.slow
def test_parts_come_as_often_as_the_lists_say() -> None:
    mixture = Mixture(SIDES, ["rooms", "rooms", "open"], plans=["apartment"], plans_share=0.25)
    plans = [mixture.layout(seed) for seed in range(4000)]
    loaded = [plan for plan in plans if plan.source == "apartment"]
    assert len(loaded) == pytest.approx(1000, abs=80)
    drawn = [plan for plan in plans if plan.source != "apartment"]
    sizes = np.bincount([size_class(plan.free.shape[0]) for plan in drawn], minlength=3)
    assert chisquare(sizes).pvalue > 1e-3
    walled = np.mean([not plan.free[0].any() for plan in drawn])
    assert walled == pytest.approx(2 / 3, abs=0.03)


@pytest.mark.slow
def test_a_bank_keeps_the_shares_of_parts_that_have_few_layouts() -> None:
    """Open floors of one size are all equal, and so is a plan: they count as often as asked."""
    bank = draw_bank(
        Mixture([[6, 6]], ["open", "rooms"], plans=["apartment"], plans_share=0.2), 1000, 2
    )
    assert len(bank) == 1000
    assert sum(source == "apartment" for source in bank.sources) == pytest.approx(200, abs=40)
    empty = bank.free[:, :6, :6].all((1, 2)) & (bank.rows == 6)
    assert empty.sum() == pytest.approx(400, abs=50)


def test_a_redraw_stays_in_its_part() -> None:
    mixture = Mixture(SIDES, ["rooms"], plans=["apartment"], plans_share=0.5)
    for seed in range(60):
        first, again = mixture.layout(seed), mixture.layout(seed, draw=1)
        if first.source == "apartment":
            assert again.source == "apartment"
        else:
            assert size_class(first.free.shape[0]) == size_class(again.free.shape[0])


@pytest.fixture
def two_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A plan with two robots drawn in it, and a region that they cannot reach."""
    monkeypatch.chdir(tmp_path)
    Path("flat.txt").write_text("1..#.\n...#.\n0aa##\n")
    return "flat.txt"


@pytest.mark.parametrize("n_agents", [1, 2, 3])
def test_given_starts_are_kept_and_others_drawn(two_starts: str, n_agents: int) -> None:
    mixture = Mixture([[5, 7]], ["rooms"], plans=[two_starts], plans_share=0.5)
    houses = draw_houses(mixture, range(40), n_agents)
    loaded = [source == two_starts for source in houses.sources]
    assert 10 < sum(loaded) < 30 and houses.starts is not None
    env = CleaningEnv(houses, n_agents=n_agents, num_envs=40, house_order=HouseOrder.FIXED)
    for index, is_loaded in enumerate(loaded):
        position = env.state.position[index].tolist()
        cells = {tuple(place) for place in position}
        assert len(cells) == n_agents and all(houses.free[index][cell] for cell in cells)
        if is_loaded:
            assert position[:2] == [[2, 0], [0, 0]][:n_agents]
            assert int(env.state.num_free[index]) == 7


@pytest.mark.slow
def test_houses_of_all_sizes_play_as_each_does_alone() -> None:
    cfg = compose_config(["house=mixture", "house.plans=[apartment]", "house.plans_share=0.3"])
    mixed = build.held_out_houses(cfg, "test", 12)
    assert len(set(zip(mixed.rows, mixed.cols, strict=True))) > 5
    together = build.make_env(cfg, mixed, num_envs=12, house_order=HouseOrder.FIXED)
    actions = torch.randint(4, (40, 12, 2), generator=torch.Generator().manual_seed(0))
    td = together.reset()
    steps = []
    for action in actions:
        td["agents", "action"] = action
        step, td = together.step_and_maybe_reset(td)
        steps.append(step["next", "agents"].clone())
    for index in (0, 5, 11):
        rows, cols = int(mixed.rows[index]), int(mixed.cols[index])
        house = Houses(
            mixed.free[index : index + 1, :rows, :cols],
            mixed.furniture[index : index + 1, :rows, :cols],
            mixed.rows[index : index + 1],
            mixed.cols[index : index + 1],
            None,
            mixed.sources[index : index + 1],
        )
        alone = build.make_env(
            cfg, house, num_envs=1, house_order=HouseOrder.FIXED, first_env=index
        )
        td = alone.reset()
        for action, step in zip(actions, steps, strict=True):
            td["agents", "action"] = action[index : index + 1]
            own, td = alone.step_and_maybe_reset(td)
            for key in ("observation", "own_reward", "position"):
                assert torch.equal(own["next", "agents", key][0], step[key][index])


@pytest.mark.slow
def test_records_name_the_seed_of_a_drawn_house_and_the_path_of_a_plan() -> None:
    settings = ["house=mixture", "house.sides=[[5,6],[8,9]]", "house.plans=[apartment]"]
    settings += ["house.plans_share=0.6", "evaluation.houses=8", "env.max_steps=30"]
    entry = measure_planner(compose_config(settings))
    assert entry["house_set"] == "test"
    kinds = {("seed" in house, "path" in house) for house in entry["houses"]}
    assert kinds == {(True, False), (False, True)}
    assert {house["path"] for house in entry["houses"] if "path" in house} == {"apartment"}
    assert [house["seed"] for house in entry["houses"] if "seed" in house] == [
        2_000_000 + index for index, house in enumerate(entry["houses"]) if "seed" in house
    ]
    sizes = {(house["rows"], house["cols"], house["max_steps"]) for house in entry["houses"]}
    assert len(sizes) > 2
    assert all(house["bound_100"] > 0 for house in entry["houses"])


@family(
    ("setting", "words"),
    [
        ("house.sides=[]", "house.sides"),
        ("house.sides=[[2,5]]", "house.sides"),
        ("house.sides=[[9,8]]", "house.sides"),
        ("house.sides=[8,9]", "house.sides"),
        ("house.margins=[[3,2]]", "house.margins"),
        ("house.margins=[[-1,2]]", "house.margins"),
        (
            "house.margins=[[0,0],[0,3]] observation=global_map observation.largest_side=20",
            "at least 26",
        ),
        ("house.kinds=[]", "house.kinds"),
        ("house.kinds=[rooms,opn]", "open"),
        ("house.plans_share=1.5", "house.plans_share"),
        ("house.plans=[nowhere.yaml]", "house.plans: "),
        ("house.plans=[walls.txt]", "house.plans: walls.txt: the floor plan has no free cell"),
        ("house.plans=[flat.txt] env.n_agents=7", "valid for env.n_agents: 1 to 6"),
        ("house.sides=[[3,3]]", "env.n_agents"),
    ],
    fast=3,
)
def test_wrong_settings_are_named_in_one_line(
    two_starts: str, setting: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("walls.txt").write_text("###\n")
    assert cli.main(["train", "house=mixture", *setting.split()]) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not Path("runs").exists()


def test_a_plan_that_is_no_text_is_a_floor_plan() -> None:
    drawn, scanned = Drawn("apartment").layout(0), Mixture([[5, 5]], plans=["apartment"])
    assert np.array_equal(scanned._loaded[0].furniture, drawn.furniture)
    with pytest.raises(BadInput, match=r"house\.plans: .*flat\.png"):
        Mixture([[5, 5]], plans=["flat.png"])
