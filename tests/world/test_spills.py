"""Spills: when and where they are drawn, who notices them, and what cleaning them pays."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.house.base import draw_houses
from marl_clean.house.open import Open
from marl_clean.settings import Memory, Sensor, Spills
from marl_clean.world import floods, spills
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_known_spilt
from tests import reference
from tests.families import family
from tests.world.play import houses_of
from tests.world.strategies import Case, cases, settings
from tests.world.test_against_reference import assert_same_play

UP, RIGHT, DOWN, LEFT = range(4)
ENOUGH = 1e-3
CORRIDOR = [[True] * 12]


def corridor(**rules) -> CleaningEnv:
    """Robot 0 at the left end of a corridor, robot 1 at its right end; one spill in step 3."""
    rules = {"memory": Memory.PRIVATE, "stuck_after": None, **rules}
    env = CleaningEnv(
        houses_of(CORRIDOR, None, [(0, 0), (0, 11)]),
        Rules(**rules),
        num_envs=1,
        contact=lambda state, rules: torch.zeros((1, 2, 2), dtype=torch.bool),
    )
    env.reset()
    env.state.spill_steps[:] = torch.tensor([[3]])
    return env


def act(env: CleaningEnv, *actions: int) -> dict[str, list[float]]:
    """What the two robots earn in a step, by term."""
    frame = env.step_worlds(torch.tensor([actions]))
    info = frame[keys.AGENTS, "info"]
    return {
        name: info[name][0, :, 0].tolist() for name in ("step", "cleaning", "discovery", "spill")
    }


def spilt(env: CleaningEnv) -> list[int]:
    """The columns of the corridor that are spilt."""
    return (env.state.spilt[0].nonzero()[:, 1] - env.rules.margin).tolist()


def known(env: CleaningEnv, robot: int) -> list[int]:
    """The columns of the corridor that a robot's map holds as spilt."""
    record = env.state.record[0, robot]
    return (is_known_spilt(record).nonzero()[:, 1] - env.rules.margin).tolist()


def after_the_spill(**rules) -> CleaningEnv:
    """Both robots have walked three steps inward: cleaned are 0 to 3, and 8 to 11."""
    env = corridor(**rules)
    for _ in range(3):
        assert not spilt(env)
        act(env, RIGHT, LEFT)
    return env


def test_steps_are_uniform_over_their_parts_and_before_any_team_can_have_finished() -> None:
    houses = draw_houses(Open(rows=[5, 5], cols=[9, 9]), [0], 3)  # 45 cells, 3 robots: 1 to 14
    rules = Rules(spills=Spills(per_episode=2))
    steps = CleaningEnv(houses, rules, n_agents=3, num_envs=7_000).state.spill_steps
    for spill, first in enumerate((1, 8)):
        counts = torch.bincount(steps[:, spill] - first, minlength=7)
        assert len(counts) == 7 and chisquare(counts.numpy()).pvalue > ENOUGH
    both = torch.stack([steps[:, 0], steps[:, 1]]).double()
    assert abs(torch.corrcoef(both)[0, 1]) < 0.05


def test_more_spills_than_steps_leave_some_out_and_share_none() -> None:
    houses = draw_houses(Open(rows=[3, 3], cols=[4, 4]), [0], 2)  # 12 cells: steps 1 to 5
    rules = Rules(spills=Spills(per_episode=9))
    for steps in CleaningEnv(houses, rules, num_envs=20).state.spill_steps.tolist():
        assert sorted(step for step in steps if step) == [1, 2, 3, 4, 5]


def test_where_is_uniform_over_the_clean_cells_without_a_robot() -> None:
    houses = houses_of(CORRIDOR, None, [(0, 0)])
    env = CleaningEnv(houses, Rules(spills=Spills(1, size=1)), n_agents=1, num_envs=6_000)
    env.state.spill_steps[:] = 5
    for _ in range(5):
        env.step_worlds(torch.full((6_000, 1), RIGHT))
    assert (env.state.num_spilt == 1).all()
    columns = env.state.spilt.nonzero()[:, 2] - env.rules.margin
    counts = torch.bincount(columns, minlength=5)  # 0 to 4: the robot is on 5
    assert len(counts) == 5 and chisquare(counts.numpy()).pvalue > ENOUGH


def test_with_no_clean_cell_but_the_robots_own_nothing_is_spilt() -> None:
    env = corridor(spills=Spills(1))
    env.state.spill_steps[:] = 1
    act(env, LEFT, RIGHT)  # both bump
    assert not spilt(env) and env.state.num_spilt.tolist() == [0]


@family("size", [1, 2, 3], fast=[2])
def test_only_clean_cells_of_the_square_become_dirty(size: int) -> None:
    env = after_the_spill(spills=Spills(1, size=size))
    columns = spilt(env)
    assert columns and set(columns) <= {0, 1, 2, 9, 10, 11}  # robots are on 3 and 8
    assert max(columns) - min(columns) < size
    assert env.state.num_spilt.tolist() == env.state.num_open_spilt.tolist() == [len(columns)]
    assert env.state.num_visited.tolist() == [8]  # coverage ignores it


@pytest.mark.parametrize("most", [None, 0, 1, 3, 4, 11])
def test_robots_within_so_many_steps_notice(most: int | None) -> None:
    env = after_the_spill(spills=Spills(1, noticed_within=most, size=2))
    columns = spilt(env)
    for robot, place in ((0, 3), (1, 8)):
        near = most is None or min(abs(column - place) for column in columns) <= most
        assert known(env, robot) == (columns if near else [])


def test_walls_make_a_spill_far() -> None:
    """Beside each other, on both sides of a wall: the way round is what counts."""
    free = [[True] * 7, [False] * 6 + [True], [True] * 7]
    env = CleaningEnv(
        houses_of(free, None, [(0, 2), (2, 0)]),
        Rules(memory=Memory.PRIVATE, spills=Spills(1, noticed_within=11, size=1)),
        num_envs=1,
        contact=lambda state, rules: torch.zeros((1, 2, 2), dtype=torch.bool),
    )
    env.reset()
    env.state.spill_steps[:] = 1
    env.step_worlds(torch.tensor([[LEFT, LEFT]]))  # (0, 2) is left, and the only clean cell
    assert [is_known_spilt(env.state.record[0, robot]).any().item() for robot in (0, 1)] == [
        True,
        False,  # 4 to the right end, 2 down, 6 back
    ]


def test_a_spilt_cell_pays_once_and_in_place_of_cleaning() -> None:
    env = after_the_spill(spills=Spills(1, size=1, pays=1.5), decay_steps=None)
    (column,) = spilt(env)
    robot, home, out = (0, LEFT, RIGHT) if column < 6 else (1, RIGHT, LEFT)
    away = abs(column - (3, 8)[robot])
    other = RIGHT if robot == 1 else LEFT  # towards its own end, over clean cells
    actions = [home, other] if robot == 0 else [other, home]
    for left in range(away, 0, -1):
        terms = act(env, *actions)
        assert terms["spill"][robot] == (1.5 if left == 1 else 0)
        assert terms["cleaning"][robot] == 0 and terms["step"][robot] == -1
        assert terms["spill"][1 - robot] == 0
    assert not spilt(env) and env.state.num_open_spilt.tolist() == [0]
    actions[robot] = out
    assert act(env, *actions)["spill"] == [0, 0]
    actions[robot] = home
    assert act(env, *actions)["spill"] == [0, 0]


def test_who_noticed_is_not_paid_for_what_another_has_cleaned() -> None:
    """Its map still holds the spill, which under `own_map` would pay as dirt does."""
    env = corridor(spills=Spills(1, size=1))
    for _ in range(3):
        act(env, RIGHT, LEFT)
    (column,) = spilt(env)
    cell = env.rules.margin, env.rules.margin + column
    env.state.spilt[0, *cell] = False  # as if another had cleaned it
    robot, home = (0, LEFT) if column < 6 else (1, RIGHT)
    assert known(env, robot) == [column]
    for _ in range(abs(column - (3, 8)[robot])):
        terms = act(env, *([home, RIGHT] if robot == 0 else [LEFT, home]))
        assert terms["cleaning"][robot] == terms["spill"][robot] == 0
    assert known(env, robot) == []


def test_touch_sees_a_spill_that_nobody_noticed() -> None:
    env = corridor(spills=Spills(1, noticed_within=0, size=3), sensor=Sensor.TOUCH4)
    for _ in range(3):
        act(env, RIGHT, LEFT)
    beside = [column for column in spilt(env) if column in (2, 9)]
    assert sorted(known(env, 0) + known(env, 1)) == beside


def test_without_spills_the_state_holds_nothing_of_them() -> None:
    state = CleaningEnv(houses_of(CORRIDOR, None, [(0, 0)]), n_agents=1, num_envs=2).state
    assert not {"spilt", "spill_steps", "num_spilt", "num_open_spilt"} & set(state.tensors())
    assert state.spilt is None


SMALL = ["train_houses=4", "house.rows=[5,8]", "house.cols=[5,8]", "env.num_envs=16"]
SPILLING = ["env.spills.per_episode=4", "env.spills.noticed_within=3", "env.memory=private"]


def play(env, steps: int, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        env.step_worlds(torch.randint(4, (env.num_envs, env.n_agents), generator=generator))


@pytest.mark.slow
def test_a_saved_state_goes_on_as_it_would_have() -> None:
    env, other = (build.make_env(compose_config([*SMALL, *SPILLING])).base_env for _ in range(2))
    env.reset()
    play(env, 6, seed=0)
    assert env.state.spilt.any()
    other.load_state_dict(env.state_dict())
    for each in (env, other):
        play(each, 15, seed=1)
    for name, value in env.state.tensors().items():
        assert torch.equal(value, getattr(other.state, name)), name
    assert (env.state.num_spilt > 3).any()


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["bump", "touch4"])
def test_a_gpus_path_gives_the_same_worlds(sensor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    played = []
    for path_of_gpu in (False, True):
        if path_of_gpu:
            monkeypatch.setattr(spills, "within_steps", floods.flood_within)
            monkeypatch.setattr(spills, "worlds_to_spill_in", lambda due: torch.arange(len(due)))
        settings = [*SMALL, *SPILLING, f"env.sensor={sensor}", "env.furniture_moves_per_episode=2"]
        env = build.make_env(compose_config(settings)).base_env
        env.reset()
        play(env, 25, seed=0)
        played.append(env.state.tensors())
    assert played[0]["num_spilt"].any()
    for name, value in played[0].items():
        assert torch.equal(value, played[1][name]), name


spilling = settings().flatmap(
    lambda drawn: st.integers(1, 12).map(lambda count: replace(drawn, spills=count))
)


@pytest.mark.long
@given(case=cases(settings=spilling, max_agents=8))
@hypothesis_settings(max_examples=30, deadline=None)
def test_spills_in_random_play_are_those_of_the_reference(case: Case) -> None:
    assert_same_play([case], whole_map=True)


@pytest.mark.long
@given(case=cases(settings=spilling, max_agents=8))
@hypothesis_settings(max_examples=30, deadline=None)
def test_spills_keep_their_promises_in_the_plain_world(case: Case) -> None:
    """What the reference does is what the rules say: a second look at the same rules."""
    world = case.world()
    paid: list[tuple[reference.Place, int]] = []
    for actions in case.actions:
        before, coverage = set(world.spilt), set(world.cleaned)
        outcome = world.step(actions)
        assert world.spilt <= world.cleaned and not world.spilt & set(world.positions)
        assert coverage <= world.cleaned or case.moves  # coverage ignores spills
        for robot, pays in enumerate(outcome.spill):
            entered = outcome.moved[robot] and outcome.target[robot] in before
            assert pays == (case.settings.spill_pays if entered else 0)
            if entered:
                assert outcome.cleaning[robot] == 0
                paid.append((outcome.target[robot], world.steps))
    assert len(set(paid)) == len(paid)
    delays = [*world.spill_delays, *(world.steps - at for at in world.spilt_at.values())]
    assert all(0 <= delay < world.steps for delay in delays)
