"""Every observation is what the plain world shows, whatever the house and the reading."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs import Compose, TransformedEnv

from marl_clean import keys
from marl_clean.observation.crop import Crop
from marl_clean.observation.distances import Distances
from marl_clean.observation.global_map import GlobalMap
from marl_clean.observation.pyramid import Pyramid
from marl_clean.settings import Memory
from tests.families import family
from tests.observation import plain
from tests.observation.compared import assert_sees
from tests.reference import Settings, World
from tests.world.play import env_of, start, topology_of
from tests.world.strategies import Case, cases

LARGEST = 9
noises = st.sampled_from([0.0, 0.5, 1.0])
sides = st.sampled_from([1, 3, 5])
small_cases = cases(max_agents=3)


@pytest.mark.slow
@given(case=small_cases, side=sides, noise=noises)
@hypothesis_settings(max_examples=25, deadline=None)
def test_a_crop_is_around_where_the_robot_thinks_it_is(case: Case, side: int, noise: float) -> None:
    def expected(world: World, robot: int, index: int) -> list:
        centre = plain.believed(world, robot, noise, index)
        return [plain.square(world, robot, centre, side)]

    assert_sees([case], Crop(side, noise), expected)


@pytest.mark.long
@given(case=small_cases, side=sides, scales=st.integers(2, 4), noise=noises)
@hypothesis_settings(max_examples=25, deadline=None)
def test_a_pyramid_counts_cells(case: Case, side: int, scales: int, noise: float) -> None:
    def expected(world: World, robot: int, index: int) -> list:
        centre = plain.believed(world, robot, noise, index)
        coarse = (plain.coarse_planes(world, robot, centre, side, s) for s in range(1, scales))
        return [plain.square(world, robot, centre, side), *(p for four in coarse for p in four)]

    assert_sees([case], Pyramid(side, scales, noise), expected)


@pytest.mark.slow
@given(case=small_cases, range_cells=st.sampled_from([1, 2, 4, 15]))
@hypothesis_settings(max_examples=25, deadline=None)
def test_distances_walk_to_the_first_wall(case: Case, range_cells: int) -> None:
    def expected(world: World, robot: int, index: int) -> list:
        return plain.distances(world, robot, range_cells)

    assert_sees([case], Distances(range_cells), expected)


@pytest.mark.long
@given(case=small_cases)
@hypothesis_settings(max_examples=25, deadline=None)
def test_a_global_map_is_all_of_it(case: Case) -> None:
    def expected(world: World, robot: int, index: int) -> list:
        return plain.whole(world, robot, LARGEST)

    assert_sees([case], GlobalMap(LARGEST), expected)


@pytest.mark.long
@family("memory", Memory, fast=1)
@given(data=st.data())
@hypothesis_settings(max_examples=6, deadline=None)
def test_houses_of_several_sizes_are_seen_as_each_alone(
    memory: Memory, data: st.DataObject
) -> None:
    first = data.draw(small_cases)
    knowledge = first.settings.knowledge
    if memory is Memory.SHARED and not isinstance(knowledge, str):
        knowledge = knowledge[0]  # one map cannot be known by some robots only
    noted = first.settings.robots_noted and memory is Memory.PRIVATE
    changed = replace(first.settings, memory=memory, knowledge=knowledge, robots_noted=noted)
    first = replace(first, settings=changed)
    n_agents = len(first.starts)
    same = cases(st.just(first.settings), n_agents).filter(lambda c: len(c.starts) == n_agents)
    drawn = [first, *data.draw(st.lists(same, min_size=1, max_size=2))]

    def crop(world: World, robot: int, index: int) -> list:
        return [plain.square(world, robot, plain.believed(world, robot, 0.5, index), 5)]

    def pyramid(world: World, robot: int, index: int) -> list:
        centre = plain.believed(world, robot, 0.5, index)
        four = plain.coarse_planes(world, robot, centre, 3, 1)
        return [plain.square(world, robot, centre, 3), *four]

    assert_sees(drawn, Crop(5, 0.5), crop)
    assert_sees(drawn, Pyramid(3, 2, 0.5), pyramid)
    assert_sees(drawn, GlobalMap(LARGEST), lambda world, i, _: plain.whole(world, i, LARGEST))
    assert_sees(drawn, Distances(3), lambda world, i, _: plain.distances(world, i, 3))


def test_distances_by_hand() -> None:
    case = Case(
        [[True] * 4, [True, True, False, True], [True] * 4],
        [[0] * 4] * 3,
        [(1, 1), (2, 3)],
        Settings(view_size=3),
        [],
        None,
        [],
    )
    env = TransformedEnv(env_of([case]).base_env, Compose(topology_of(case.settings), Distances(2)))
    seen = start(env, [case])[keys.OBSERVATION][0]
    #                        N    NE   E    SE   S    SW   W    NW
    assert seen[0].tolist() == [0.5, 0.5, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5]
    assert seen[1].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
