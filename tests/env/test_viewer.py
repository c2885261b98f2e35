"""The picture shows each cell where it lies, on houses that are not square."""

import re
import tracemalloc

import numpy as np
import pytest

from marl_clean.env import viewer
from marl_clean.env.viewer import Layout, Scene, draw, draw_text, fitting_cell

SHAPES = [(3, 7), (7, 3), (1, 5)]


def scene_of(rows: int, cols: int, **changes) -> Scene:
    """A bare dirty floor, all of it unknown, with robot 1 in the last cell."""
    settings = {
        "free": np.ones((rows, cols), dtype=bool),
        "furniture": np.zeros((rows, cols), dtype=np.int16),
        "cleaned": np.zeros((rows, cols), dtype=bool),
        "values": np.full((rows, cols), -0.2, dtype=np.float32),
        "positions": [(rows - 1, cols - 1)],
        "step": 3,
        "coverage": 0.25,
    }
    return Scene(**{**settings, **changes})


def pixel(picture: np.ndarray, scene: Scene, panel: int, place: tuple[int, int], cell: int):
    """The colour in the middle of a cell."""
    row, col = Layout(*scene.free.shape, cell).centre(panel, place)
    return tuple(int(value) for value in picture[int(row), int(col)])


@pytest.mark.parametrize(("rows", "cols"), SHAPES)
@pytest.mark.parametrize("cell", [8, 21])
def test_every_cell_of_both_panels_has_its_own_colour(rows, cols, cell):
    for place in np.ndindex(rows, cols):
        if place == (rows - 1, cols - 1):
            continue  # the robot stands there
        scene = scene_of(rows, cols)
        scene.free[place] = False
        scene.values[place] = -1
        picture = draw(scene, cell)
        for other in np.ndindex(rows, cols):
            if cell == 8 and max(abs(other[0] - rows + 1), abs(other[1] - cols + 1)) < 2:
                continue  # under the robot, which is drawn larger than small cells
            if other == (rows - 1, cols - 1):
                continue
            house = viewer.WALL if other == place else viewer.DIRTY
            known = viewer.BLOCKED if other == place else viewer.UNKNOWN
            assert pixel(picture, scene, 0, other, cell) == house
            assert pixel(picture, scene, 1, other, cell) == known


@pytest.mark.parametrize(("rows", "cols"), [(3, 7), (7, 3)])
def test_furniture_clean_floor_and_age_have_different_colours(rows, cols):
    scene = scene_of(rows, cols)
    scene.free[0, 1] = False
    scene.furniture[0, 1] = 2
    scene.cleaned[1, 0] = True
    scene.values[1, 0] = 0.5
    scene.values[0, 2] = 0.0
    picture = draw(scene, 16)
    assert pixel(picture, scene, 0, (0, 1), 16) == viewer.FURNITURE
    assert pixel(picture, scene, 0, (1, 0), 16) == viewer.CLEAN
    assert pixel(picture, scene, 1, (1, 0), 16) == viewer.CLEAN
    assert pixel(picture, scene, 1, (0, 2), 16) == viewer.DIRTY


def test_a_cell_fades_from_clean_to_dirty():
    values = np.array([[0.5, 0.4, 0.2, 0.05, 0.0]], dtype=np.float32)
    distance = np.abs(viewer.map_colours(values).astype(int) - np.array(viewer.DIRTY)).sum(-1)
    assert (np.diff(distance[0]) < 0).all() and distance[0, -1] == 0


@pytest.mark.parametrize(("rows", "cols"), [(3, 7), (7, 3)])
def test_robots_and_contacts_stand_in_both_panels(rows, cols):
    scene = scene_of(rows, cols, positions=[(0, 0), (2, 2)], contacts=[(0, 1)])
    picture = draw(scene, 24)
    layout = Layout(rows, cols, 24)
    for panel in (0, 1):
        for robot, place in enumerate(scene.positions):
            row, col = layout.centre(panel, place)
            beside_the_number = tuple(int(v) for v in picture[int(row), int(col) - 8])
            assert beside_the_number == viewer.robot_colour(robot)
        assert pixel(picture, scene, panel, (1, 1), 24) == viewer.CONTACT


def test_the_same_scene_gives_the_same_pixels_and_size_never_depends_on_the_moment():
    early = draw(scene_of(3, 7), 12)
    later = draw(scene_of(3, 7, step=12345, coverage=1.0), 12)
    assert np.array_equal(early, draw(scene_of(3, 7), 12))
    assert early.shape == later.shape == (*_size(3, 7, 12), 3)
    assert early.dtype == np.uint8


def _size(rows: int, cols: int, cell: int) -> tuple[int, int]:
    layout = Layout(rows, cols, cell)
    return layout.height, layout.width


@pytest.mark.parametrize(("rows", "cols"), [(3, 7), (7, 3)])
def test_text_has_two_characters_a_cell_and_colours_only_on_demand(rows, cols):
    scene = scene_of(rows, cols, positions=[(0, 0), (2, 1)], contacts=[(0, 1)])
    scene.free[1, 2] = False
    plain = draw_text(scene, colour=False).splitlines()
    assert len(plain) == rows + 2
    assert all(len(line) == 4 * cols + 3 for line in plain[1:-1])
    assert plain[1].startswith(" 1..") and plain[3].startswith(".. 2")
    assert plain[2][4:6] == "##" and plain[2][2 * cols + 3 :] == "??" * cols
    assert plain[-1] == "step 3   25.0 % clean   contact 1-2"
    coloured = re.sub("\x1b\\[[0-9;]*m", "", draw_text(scene))
    assert [len(line) for line in coloured.splitlines()] == [len(line) for line in plain]


@pytest.mark.parametrize(("rows", "cols"), [(10, 10), (3, 7)])
def test_a_cell_of_a_usual_house_has_24_pixels(rows, cols):
    scene = scene_of(rows, cols)
    assert np.array_equal(draw(scene), draw(scene, 24))


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols"), [(256, 256), (1500, 3000)])
def test_a_picture_is_bounded_whatever_the_house(rows, cols):
    scene = scene_of(rows, cols, positions=[(rows // 2, cols // 2)])
    scene.free[: rows // 4] = False
    tracemalloc.start()
    picture = draw(scene)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200_000_000 and max(picture.shape) < 2200
    shrink = -(-max(rows, cols) // viewer.MOST_CELLS)
    side = fitting_cell(rows // shrink, cols // shrink)
    layout = Layout(rows // shrink, cols // shrink, side)
    for place, colour in [((rows // 8, cols // 2), viewer.WALL), ((rows - 4, 5), viewer.DIRTY)]:
        row, col = layout.centre(0, (place[0] // shrink, place[1] // shrink))
        assert tuple(int(value) for value in picture[int(row), int(col)]) == colour
    centre = layout.centre(1, (rows // 2 / shrink, cols // 2 / shrink))
    row, col = map(int, centre)
    disc = picture[row - 5 : row + 6, col - 5 : col + 6]
    assert (disc == viewer.robot_colour(0)).all(-1).sum() > 20
