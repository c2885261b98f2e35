"""SmartDFS keeps the bound that its authors prove, on drawn grid polygons without obstacles."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.evaluation.bounds import walking_distance
from marl_clean.house.base import Houses
from marl_clean.planner.base import Planner
from marl_clean.planner.boustrophedon import Boustrophedon
from marl_clean.planner.smart_dfs import SmartDFS
from marl_clean.settings import HouseOrder, Sensor

EIGHT = np.ones((3, 3), dtype=bool)
SHAPES = ((1, 9), (9, 1), (3, 7), (7, 3), (6, 6), (8, 11), (12, 12))


def is_simple_polygon(free: np.ndarray) -> bool:
    """One connected region, and no obstacle that does not touch the outer wall."""
    regions = ndimage.label(free)[1]
    walls = ndimage.label(np.pad(~free, 1, constant_values=True), EIGHT)[1]
    return regions == 1 and walls == 1 and free.sum() >= 2


def polygon(draw: random.Random) -> np.ndarray:
    """A rectangle of cells with rectangles cut off, as long as it stays a simple polygon."""
    rows, cols = draw.choice(SHAPES)
    free = np.ones((rows, cols), dtype=bool)
    for _ in range(draw.randrange(25)):
        height, width = draw.randint(1, max(1, rows // 2)), draw.randint(1, max(1, cols // 2))
        row, col = draw.randrange(rows), draw.randrange(cols)
        cut = free.copy()
        cut[row : row + height, col : col + width] = False
        free = cut if is_simple_polygon(cut) else free
    return free


def boundary(free: np.ndarray) -> tuple[int, list[tuple[int, int]]]:
    """How many edges of free cells are walls, and the cells that have one."""
    padded = np.pad(free, 1)
    beside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])
    walls = np.stack([~side & free for side in beside])
    return int(walls.sum()), [(int(row), int(col)) for row, col in np.argwhere(walls.any(0))]


def tours(planner: Planner, houses: list[np.ndarray], starts: list[tuple[int, int]]) -> np.ndarray:
    """Steps of one robot with a touch sensor to clean each house, and to walk back to its start."""
    rows, cols = (max(house.shape[axis] for house in houses) for axis in (0, 1))
    stack = np.stack([np.pad(h, ((0, rows - h.shape[0]), (0, cols - h.shape[1]))) for h in houses])
    env = CleaningEnv(
        Houses(
            free=stack,
            furniture=np.zeros(stack.shape, dtype=np.int16),
            rows=np.array([house.shape[0] for house in houses]),
            cols=np.array([house.shape[1] for house in houses]),
            starts=np.array(starts)[:, None],
            sources=["drawn"] * len(houses),
        ),
        n_agents=1,
        num_envs=len(houses),
        sensor=Sensor.TOUCH4,
        house_order=HouseOrder.FIXED,
        stuck_after=None,
        max_steps=4 * rows * cols,
    )
    policy, td = planner.bind(env), env.reset()
    took = np.full(len(houses), -1)
    back = walking_distance(stack, np.array(starts)[:, None])
    while (took < 0).any():
        td = env.step_mdp(env.step(policy(td)))
        state = env.state
        assert int(state.step.max()) < 4 * rows * cols, "a house is never finished"
        now = (state.num_visited >= state.num_free).numpy() & (took < 0)
        last = state.position[:, 0].numpy()
        way = back[np.arange(len(houses)), last[:, 0], last[:, 1]]
        took = np.where(now, state.step.numpy() + way, took)
    return took


def longer_than_proven(planner: Planner, seed: int, count: int = 24) -> int:
    """In how many drawn polygons the closed tour is longer than F + E/2 - 3."""
    draw = random.Random(seed)
    houses = [polygon(draw) for _ in range(count)]
    edges, beside_walls = zip(*map(boundary, houses), strict=True)
    starts = [draw.choice(cells) for cells in beside_walls]
    bound = np.array([house.sum() for house in houses]) + np.array(edges) / 2 - 3
    return int((tours(planner, houses, starts) > bound).sum())


@given(st.integers(0, 2**32))
@settings(max_examples=4, deadline=None)
def test_a_closed_tour_is_no_longer_than_proven(seed):
    assert longer_than_proven(SmartDFS(), seed) == 0


def test_the_bound_is_one_that_other_planners_miss():
    assert sum(longer_than_proven(Boustrophedon(), seed) for seed in range(3)) > 0


@pytest.mark.parametrize("shape", [(1, 6), (6, 1), (2, 2), (5, 4)])
def test_a_rectangle_takes_its_cells_and_no_step_more_than_proven(shape):
    free = np.ones(shape, dtype=bool)
    edges, _ = boundary(free)
    (steps,) = tours(SmartDFS(), [free], [(0, 0)])
    assert 2 * (free.sum() - 1) * (1 in shape) <= steps <= free.sum() + edges / 2 - 3
