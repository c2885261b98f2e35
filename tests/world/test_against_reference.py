"""The tensor world equals the plain one, step for step, whatever the reading."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.settings import Knowledge, Memory, Sensor
from marl_clean.world.sensing import crossed_cells
from tests.reference import Settings, World
from tests.world.play import env_of, say, start
from tests.world.strategies import MOST_AGENTS, Case, cases, settings

EXAMPLES = 100


def assert_same_observation(tensordict, index: int, world: World, side: int) -> None:
    n_agents = len(world.positions)
    assert tensordict[keys.POSITION][index].tolist() == [list(p) for p in world.positions]
    assert tensordict[keys.ADJACENCY][index].tolist() == world.contacts()
    assert tensordict[keys.DISTANCE_RANK][index].tolist() == world.distance_rank()
    expected = torch.tensor(
        [[[float(v) for v in row] for row in world.view(i, side)] for i in range(n_agents)]
    )
    torch.testing.assert_close(
        tensordict[keys.OBSERVATION][index, :, 0], expected, atol=1e-6, rtol=0
    )


def assert_same_outcome(tensordict, env, index: int, world: World, outcome) -> None:
    state, margin = env.state, env.rules.margin
    assert state.moved[index].tolist() == outcome.moved
    assert state.bumped[index].tolist() == outcome.bumped
    assert state.collided[index].tolist() == outcome.collided
    assert state.newly_cleaned[index].tolist() == outcome.newly_cleaned
    readings = world.settings
    collision = [(keys.INFO_COLLISION, outcome.collision)] if readings.collision_pays else []
    shaping = [(keys.INFO_SHAPING, outcome.shaping)] if readings.shaping else []
    spills = [(keys.INFO_SPILL, outcome.spill)] if readings.spills else []
    for key, expected in (
        *collision,
        *shaping,
        *spills,
        (keys.INFO_STEP, outcome.step),
        (keys.INFO_CLEANING, outcome.cleaning),
        (keys.INFO_DISCOVERY, outcome.discovery),
        (keys.OWN_REWARD, outcome.own_reward),
        (keys.REWARD, outcome.reward),
    ):
        expected = torch.tensor([float(value) for value in expected])
        torch.testing.assert_close(tensordict[key][index, :, 0], expected, atol=1e-5, rtol=0)
    assert bool(tensordict[keys.TERMINATED][index]) == outcome.terminated
    assert bool(tensordict[keys.TRUNCATED][index]) == outcome.truncated
    readings = world.settings
    told = readings.patches not in (None, "coded")
    if readings.exchange_cells is not None or readings.lends or told:
        assert state.exchanged_bits[index].tolist() == world.exchanged_bits
    assert (int(state.num_visited[index]), int(state.num_free[index])) == world.coverage()
    if world.settings.spills:
        places = {
            (row - margin, col - margin) for row, col in state.spilt[index].nonzero().tolist()
        }
        assert places == world.spilt
        assert int(state.num_open_spilt[index]) == len(world.spilt)
        assert int(state.num_spilt[index]) == len(world.spilt) + len(world.spill_delays)


def assert_same_play(drawn: list[Case], whole_map: bool) -> None:
    env = env_of(drawn, whole_map)
    worlds = [case.world(index) for index, case in enumerate(drawn)]
    side = env.transform[1].view_size
    tensordict = start(env, drawn)
    for index, world in enumerate(worlds):
        assert_same_observation(tensordict, index, world, side)
    playing = [True] * len(drawn)
    for step in range(max(len(case.actions) for case in drawn)):
        actions = [case.actions[min(step, len(case.actions) - 1)] for case in drawn]
        tensordict[keys.ACTION] = torch.tensor(actions)
        say(tensordict, drawn, step)
        after = env.step(tensordict)["next"]
        for index, world in enumerate(worlds):
            if not playing[index] or step >= len(drawn[index].actions):
                continue
            outcome = world.step(actions[index])
            assert_same_outcome(after, env.base_env, index, world, outcome)
            assert_same_observation(after, index, world, side)
            playing[index] = not (outcome.terminated or outcome.truncated)
        tensordict = _carry(tensordict, after)


def _carry(tensordict, after):
    carried = tensordict.clone(False)
    carried["next"] = after
    return step_mdp(carried)


@pytest.mark.slow
@given(case=cases(max_agents=MOST_AGENTS), whole_map=st.booleans())
@hypothesis_settings(max_examples=EXAMPLES, deadline=None)
def test_every_step_of_random_play_is_the_reference(case: Case, whole_map: bool) -> None:
    assert_same_play([case], whole_map)


@pytest.mark.long
@given(data=st.data())
@hypothesis_settings(max_examples=30, deadline=None)
def test_several_worlds_together_equal_each_alone(data: st.DataObject) -> None:
    """One env plays several houses of different sizes; each is as the reference alone."""
    first = data.draw(cases(max_agents=3))
    n_agents = len(first.starts)
    others = data.draw(
        st.lists(
            cases(settings=st.just(first.settings), max_agents=n_agents).filter(
                lambda case: len(case.starts) == n_agents
            ),
            min_size=1,
            max_size=3,
        )
    )
    assert_same_play([first, *others], whole_map=True)


not_stale = st.sampled_from([Knowledge.UNKNOWN, Knowledge.MEMORISED])
private = {
    "memory": st.just(Memory.PRIVATE),
    "knowledge": st.one_of(not_stale, st.tuples(*[not_stale] * MOST_AGENTS)),
}
cells = st.sampled_from([1, 2, 3, 8, 200])
exchanging = st.builds(replace, settings(), exchange_cells=cells, **private)
lending = st.builds(replace, settings(), lends=st.just(True), **private)
kinds = st.sampled_from(["all", "cleaned", "blocked", "coded", "coded"])
hearing_patches = st.builds(replace, settings(), patches=kinds, **private)


@pytest.mark.long
@given(case=cases(settings=exchanging), whole_map=st.booleans())
@hypothesis_settings(max_examples=40, deadline=None)
def test_maps_exchanged_a_few_cells_a_step_are_the_references(case: Case, whole_map: bool) -> None:
    assert_same_play([case], whole_map)


@pytest.mark.long
@given(case=cases(settings=lending), whole_map=st.booleans())
@hypothesis_settings(max_examples=40, deadline=None)
def test_maps_that_are_lent_are_the_references(case: Case, whole_map: bool) -> None:
    assert_same_play([case], whole_map)


@pytest.mark.long
@given(case=cases(settings=hearing_patches), whole_map=st.booleans())
@hypothesis_settings(max_examples=40, deadline=None)
def test_patches_that_are_heard_are_the_references(case: Case, whole_map: bool) -> None:
    assert_same_play([case], whole_map)


def test_what_is_touched_at_step_0_is_newer_than_what_was_memorised() -> None:
    """Robot 1 stands where a wall was; touching tells it, and it tells robot 0."""
    readings = Settings(
        memory=Memory.MERGED, knowledge=Knowledge.STALE, sensor=Sensor.TOUCH4, view_size=3
    )
    memorised = [[True, False, True], [True, False, True], [True, True, True]]
    case = Case([[True] * 3] * 3, [[0] * 3] * 3, [(0, 0), (0, 1)], readings, [], memorised, [])
    assert case.world().seen(0)[1, 1] == 0
    assert_same_play([case], whole_map=True)


def test_sight_lines_cross_what_they_should() -> None:
    table = crossed_cells(2)

    def crossed(row: int, col: int) -> set[tuple[int, int]]:
        return {(r, c) for r, c in table[row + 2, col + 2].tolist()}

    assert crossed(0, 2) == {(0, 0), (0, 1), (0, 2)}
    assert crossed(1, 1) == {(0, 0), (1, 1)}  # through the corner of (0, 1) and (1, 0)
    assert crossed(1, 2) == {(0, 0), (0, 1), (1, 1), (1, 2)}
    assert crossed(-2, 1) == {(0, 0), (-1, 0), (-1, 1), (-2, 1)}
