"""The compass is what plain searches and counts over the robots' map give, cell by cell."""

import math
from collections import deque
from itertools import product

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs import Compose, TransformedEnv

from marl_clean import keys
from marl_clean.observation.compass import Compass
from tests.observation.plain import believed
from tests.reference import Place, World, neighbour, neighbours
from tests.world.play import env_of, follow, topology_of
from tests.world.strategies import Case, cases

STEPS = 12
FAR = 1023
CLOSE = {"atol": 1e-6, "rtol": 0}


class PlainCompass:
    """The observation of one robot, from the plain world alone."""

    def __init__(self, world: World, robot: int, noise: float, index: int) -> None:
        self.world, self.robot, self.known = world, robot, world.map_of(robot)
        self.centre = believed(world, robot, noise, index)
        self.others = [world.positions[other] for other in world.seen_robots(robot)]
        rows, cols = range(-1, world.rows + 1), range(-1, world.cols + 1)
        self.cells = list(product(rows, cols))

    def is_unknown(self, place: Place) -> bool:
        return place in self.cells and place not in self.known

    def is_blocked(self, place: Place) -> bool:
        return place in self.known and self.known[place].blocked

    def is_free(self, place: Place) -> bool:
        return place in self.known and not self.known[place].blocked

    def is_uncleaned(self, place: Place) -> bool:
        return self.is_free(place) and self.known[place].cleaned is None

    def continues_a_wall(self, place: Place) -> bool:
        row, col = place
        for down, right in ((0, 1), (1, 0)):
            wall = {k: self.is_blocked((row + k * down, col + k * right)) for k in (-2, -1, 1, 2)}
            if (wall[-2] and wall[-1]) or (wall[-1] and wall[1]) or (wall[1] and wall[2]):
                return True
        return False

    def walk(self, begin: Place, goals: set[Place]) -> dict[Place, int]:
        """Steps from a place to others; goals are walked onto, and over where they are free."""
        steps, queue = {begin: 0}, deque([begin])
        while queue:
            place = queue.popleft()
            if place != begin and not self.is_free(place):
                continue
            for beside in neighbours(place):
                if beside not in steps and (self.is_free(beside) or beside in goals):
                    steps[beside] = steps[place] + 1
                    queue.append(beside)
        return steps

    def ways(self, goals: set[Place], rivals: list[Place]) -> list[float]:
        own = self.walk(self.centre, goals)
        of_rivals = [self.walk(rival, goals) for rival in rivals]
        left = {
            goal
            for goal in goals
            if own.get(goal, 0) > 0
            and all(own[goal] <= walk.get(goal, own[goal]) for walk in of_rivals)
        }
        if not left:
            return [0.0] * 4 + [self.far(None)]
        nearest = min(own[goal] for goal in left)
        targets = {goal for goal in left if own[goal] == nearest}
        shown = []
        for action in range(4):
            beside = neighbour(self.centre, action)
            enters = self.is_free(beside) or beside in goals
            onward = self.walk(beside, goals) if enters else {}
            shown.append(float(any(onward.get(goal) == nearest - 1 for goal in targets)))
        return [*shown, self.far(nearest)]

    def far(self, steps: int | None) -> float:
        return math.log2(1 + min(FAR, FAR if steps is None else steps)) / 10

    def numbers(self, side: int) -> list[float]:
        row, col = self.centre
        reach = range(-(side // 2), side // 2 + 1)
        square = [(row + down, col + right) for down in reach for right in reach]
        unknown = {place for place in self.cells if self.is_unknown(place)}
        house = set(product(range(self.world.rows), range(self.world.cols)))
        unvisited = unknown & house
        goals = unvisited | {place for place in self.cells if self.is_uncleaned(place)}
        steps = {place: self.to_goal(place, goals) for place in [self.centre, *square]}
        for action in range(4):
            beside = neighbour(self.centre, action)
            steps[beside] = self.to_goal(beside, goals)
        own = steps[self.centre]

        shown: list[float] = [float(self.is_blocked(place)) for place in square]
        shown += [float(place in unknown) for place in square]
        shown += [self.cleanness(place) for place in square]
        shown += [self.nearer(own, steps[place]) for place in square]
        shown += [float(place in self.others) for place in square]
        for block in (3, 9):
            first = 5 * block // 2
            inside = {
                (i, j): [
                    (row - first + i * block + down, col - first + j * block + right)
                    for down, right in product(range(block), repeat=2)
                ]
                for i, j in product(range(5), repeat=2)
            }
            share = [sum(p in unknown for p in places) / block**2 for places in inside.values()]
            shown += share
            shown += [sum(map(self.is_blocked, ps)) / block**2 for ps in inside.values()]
            shown += [float(each > 0) for each in share]
            shown += [float(any(p in self.others for p in ps)) for ps in inside.values()]
        beside = [neighbour(self.centre, action) for action in range(4)]
        shown += [float(steps[p] is not None and (own is None or steps[p] < own)) for p in beside]
        shown += [float(place in unknown) for place in beside]
        shown += [float(self.is_blocked(place)) for place in beside]
        shown.append(self.far(own))
        shown += self.nearest_other()
        shown += self.ways(unvisited, self.others)
        onward = {place for place in unvisited if not self.continues_a_wall(place)}
        return shown + self.ways(onward, [])

    def news(self, side: int) -> list[float]:
        """Which cells a robot in contact knows and this one does not: near, and in blocks."""
        row, col = self.centre
        robots = range(self.world.n_agents)
        mine = self.world.contacts()[self.robot]
        told = {p for other in robots if mine[other] for p in self.world.map_of(other)}
        news = told - set(self.known)
        reach = range(-(side // 2), side // 2 + 1)
        shown = [float((row + down, col + right) in news) for down in reach for right in reach]
        for block in (3, 9):
            first = 5 * block // 2
            for i, j in product(range(5), repeat=2):
                top, left = row - first + i * block, col - first + j * block
                cells = product(range(top, top + block), range(left, left + block))
                shown.append(sum(place in news for place in cells) / block**2)
        return shown

    def to_goal(self, place: Place, goals: set[Place]) -> int | None:
        """Steps from a place to the nearest goal; None from where no robot can walk."""
        if place in goals:
            return 0
        if not self.is_free(place):
            return None
        return min(
            (n for goal, n in self.walk(place, goals).items() if goal in goals), default=None
        )

    def cleanness(self, place: Place) -> float:
        if not self.is_free(place):
            return 0.0
        cleaned = self.known[place].cleaned
        return -1.0 if cleaned is None else 0.3 + 0.7 * math.exp((cleaned - self.world.steps) / 12)

    def nearer(self, own: int | None, steps: int | None) -> float:
        if own is None:
            return 0.0
        return -1.0 if steps is None else max(-1.0, min(1.0, (own - steps) / 3))

    def nearest_other(self) -> list[float]:
        seen = [(r - self.centre[0], c - self.centre[1]) for r, c in self.others]
        if not seen:
            return [0.0] * 4
        row, col = min(seen, key=lambda o: (o[0] ** 2 + o[1] ** 2, *o))
        cut = [max(-1.0, min(1.0, each / 10)) for each in (row, col)]
        return [*cut, 1.0, 1 / (1 + math.hypot(row, col))]


@pytest.mark.slow
@given(
    case=cases(max_agents=4),
    side=st.sampled_from([3, 5, 7]),
    noise=st.sampled_from([0.0, 0.0, 0.5]),
)
@hypothesis_settings(max_examples=20, deadline=None)
def test_every_number_is_a_plain_counts(case: Case, side: int, noise: float) -> None:
    assert_compass([case], side, noise)


@pytest.mark.slow
@given(data=st.data())
@hypothesis_settings(max_examples=10, deadline=None)
def test_a_larger_house_beside_it_changes_nothing(data: st.DataObject) -> None:
    first = data.draw(cases(max_agents=2))
    n_agents = len(first.starts)
    same = cases(st.just(first.settings), n_agents).filter(lambda c: len(c.starts) == n_agents)
    assert_compass([first, data.draw(same)], 7, 0.0)


def assert_compass(drawn: list[Case], side: int, noise: float) -> None:
    base = env_of(drawn).base_env
    compass = Compass(side, noise, news=True)
    env = TransformedEnv(base, Compose(topology_of(drawn[0].settings), compass))
    for frame, worlds in follow(env, drawn, STEPS):
        shown = frame[keys.OBSERVATION]
        by_tensors = compass.by_tensors(base.state, base.setup)
        torch.testing.assert_close(by_tensors, shown[..., : by_tensors.shape[-1]], **CLOSE)
        for index, world in worlds:
            for robot in range(world.n_agents):
                plain = PlainCompass(world, robot, noise, index)
                expected = plain.numbers(side) + plain.news(side)
                torch.testing.assert_close(shown[index, robot], torch.tensor(expected), **CLOSE)
