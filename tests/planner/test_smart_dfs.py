"""SmartDFS is the paper's recursion, step by step, and keeps the paper's bound."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from torchrl.envs.utils import step_mdp

from marl_clean.keys import ACTION
from marl_clean.planner.smart_dfs import SmartDFS
from marl_clean.settings import Sensor
from tests import reference
from tests.reference import Place, neighbour, neighbours, walking_distances
from tests.world.play import env_of
from tests.world.strategies import Case, grid, is_connected

Polygon = tuple[set[Place], tuple[int, int], Place]  # free cells, rows and columns, start
CIRCLE = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))


def touching(place: Place) -> list[Place]:
    return [(place[0] + down, place[1] + right) for down, right in CIRCLE]


def has_no_obstacle(free: set[Place], rows: int, cols: int) -> bool:
    """Whether every blocked cell hangs together, also over corners, with what is outside."""
    blocked = {(r, c) for r in range(-1, rows + 1) for c in range(-1, cols + 1)} - free
    connected, queue = {(-1, -1)}, [(-1, -1)]
    while queue:
        new = {place for place in touching(queue.pop()) if place in blocked} - connected
        connected |= new
        queue += new
    return connected == blocked


@st.composite
def polygons(draw: st.DrawFn, most: int = 9) -> Polygon:
    """A simple grid polygon and a start beside its wall."""
    rows, cols = draw(st.integers(1, most)), draw(st.integers(2, most))
    free = {(row, col) for row in range(rows) for col in range(cols)}
    place = st.tuples(st.integers(0, rows - 1), st.integers(0, cols - 1))
    size = st.tuples(st.integers(1, 3), st.integers(1, 3))
    for (top, left), (height, width) in draw(st.lists(st.tuples(place, size), max_size=20)):
        cut = {(top + down, left + right) for down in range(height) for right in range(width)}
        left_over = free - cut
        if len(left_over) < 2 or not is_connected(left_over):
            continue
        if has_no_obstacle(left_over, rows, cols):
            free = left_over
    beside_wall = sorted(cell for cell in free if any(p not in free for p in neighbours(cell)))
    return free, (rows, cols), draw(st.sampled_from(beside_wall))


def case_of(free: set[Place], shape: tuple[int, int], starts: list[Place], **changes) -> Case:
    defaults = {"sensor": Sensor.TOUCH4, "stuck_after": None, "max_steps": 500, "view_size": 1}
    settings = reference.Settings(**{**defaults, **changes})
    return Case(grid(free, *shape), [[0] * shape[1]] * shape[0], starts, settings, [], None, [])


def tours(polygons: list[Polygon]) -> list[list[Place]]:
    """Where one robot in each house stands at each step until the house is clean."""
    env = env_of([case_of(free, shape, [start]) for free, shape, start in polygons])
    planner, td = SmartDFS().bind(env.base_env), env.reset()
    places = [[start] for _, _, start in polygons]
    playing = set(range(len(polygons)))
    for _ in range(200):
        td = step_mdp(env.step(planner(td)))
        position, clean = td["agents", "position"][:, 0].tolist(), td["terminated"].flatten()
        for index in list(playing):
            places[index].append((position[index][0], position[index][1]))
            if clean[index]:
                playing.remove(index)
        if not playing:
            return places
    raise AssertionError("never clean")


several_polygons = st.lists(polygons(), min_size=12, max_size=12)


@pytest.mark.long
@given(several_polygons)
@hypothesis_settings(max_examples=10, deadline=None)
def test_a_closed_tour_takes_at_most_cells_plus_half_the_edges_less_three(drawn) -> None:
    for (free, _, start), places in zip(drawn, tours(drawn), strict=True):
        edges = sum(place not in free for cell in free for place in neighbours(cell))
        back = walking_distances(free, start)[places[-1]]
        assert set(places) == free
        assert len(places) - 1 + back <= len(free) + edges / 2 - 3


class Explorer:
    """The paper's ExploreCell and ExploreStep, as the recursion that they are."""

    def __init__(self, free: set[Place], start: Place) -> None:
        self.free, self.visited = free, {start}
        self.places = [start]

    def layer(self, cell: Place) -> int:
        """Distance, diagonals as 1, to the nearest wall that a visited cell has touched."""
        touched = {p for seen in self.visited for p in neighbours(seen) if p not in self.free}
        return min(max(abs(cell[0] - r), abs(cell[1] - c)) for r, c in touched)

    def is_known_wall(self, cell: Place) -> bool:
        return cell not in self.free and any(p in self.visited for p in neighbours(cell))

    def runs(self, cell: Place) -> list[tuple[set[Place], int]]:
        """Components of open cells around `cell`, each with how many of its flanks surround it."""
        circle = touching(cell)
        closed = [k for k in range(8) if circle[k] in self.visited or self.is_known_wall(circle[k])]
        runs = []
        for first, second in pairwise([*closed, closed[0] + 8]):
            run = {circle[k % 8] for k in range(first + 1, second)}
            flanks = [circle[first], circle[second % 8]]
            inner = [self.layer(f) if f in self.visited else 0 for f in flanks]
            if run & set(neighbours(cell)):
                runs.append((run, sum(layer >= self.layer(cell) for layer in inner)))
        return runs

    def choices(self, cell: Place, direction: int) -> list[int]:
        """The directions still open, in the order in which they are taken."""
        order = [(direction + shift) % 4 for shift in (3, 0, 1, 2)]
        choices = [
            choice for choice in order if neighbour(cell, choice) in self.free - self.visited
        ]
        runs = self.runs(cell) if choices else []
        if len(runs) < 2:
            return choices
        partial = [run for run, flanks in runs if flanks == 1]
        late = partial or [run for run, _ in runs if neighbour(cell, choices[0]) in run]
        is_late = {w: any(neighbour(cell, w) in run for run in late) for w in choices}
        return sorted(choices, key=lambda choice: is_late[choice])

    def explore(self, cell: Place, direction: int) -> None:
        while choices := self.choices(cell, direction):
            self.walk(cell)
            target = neighbour(cell, choices[0])
            self.visited.add(target)
            self.places.append(target)
            self.explore(target, choices[0])

    def walk(self, cell: Place) -> None:
        """A shortest way over visited cells, ties up, right, down, left."""
        steps = walking_distances(self.visited, cell)
        while (here := self.places[-1]) != cell:
            closer = [p for p in neighbours(here) if steps.get(p, len(steps)) < steps[here]]
            self.places.append(closer[0])


@pytest.mark.long
@given(several_polygons)
@hypothesis_settings(max_examples=8, deadline=None)
def test_every_step_is_that_of_the_recursion(drawn) -> None:
    for (free, _, start), places in zip(drawn, tours(drawn), strict=True):
        explorer = Explorer(free, start)
        behind = [neighbour(start, direction + 2 & 3) in free for direction in range(4)]
        explorer.explore(start, behind.index(False))
        assert places == explorer.places


@pytest.mark.parametrize(
    ("free", "shape"),
    [({(0, col) for col in range(7)}, (1, 7)), ({(row, 0) for row in range(7)}, (7, 1))],
)
def test_from_the_middle_of_a_corridor_it_goes_to_one_end_and_back_to_the_other(
    free, shape
) -> None:
    middle = sorted(free)[3]
    assert len(tours([(free, shape, middle)])[0]) - 1 == 3 + 6


@pytest.mark.slow
def test_several_robots_share_what_is_done_and_begin_anew_in_each_episode() -> None:
    free = {(row, col) for row in range(6) for col in range(7)}
    env = env_of([case_of(free, (6, 7), [(0, 0), (5, 6)], sensor=Sensor.BUMP, max_steps=30)])
    planner, episodes = SmartDFS().bind(env.base_env), []
    for _ in range(2):
        td, actions = env.reset(), []
        for _ in range(30):
            td = planner(td)
            actions.append(td[ACTION][0].tolist())
            td = step_mdp(env.step(td))
        assert int(env.base_env.state.num_visited) > 36
        episodes.append(actions)
    assert episodes[0] == episodes[1]
