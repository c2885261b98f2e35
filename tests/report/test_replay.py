"""The GIF shows the whole episode, its first and last moment, and stays small."""

import numpy as np
import pytest
from PIL import Image

from marl_clean.env import viewer
from marl_clean.env.viewer import Layout, Scene, fitting_cell
from marl_clean.report import replay
from marl_clean.report.replay import PANEL_PIXELS, drawn, write_gif


def moments(count: int, rows: int = 3, cols: int = 7) -> list[Scene]:
    """A robot that walks the house row by row, cleaning."""
    frames = []
    for step in range(count):
        cleaned = (np.arange(rows * cols) <= step).reshape(rows, cols)
        frames.append(
            Scene(
                free=np.ones((rows, cols), dtype=bool),
                furniture=np.zeros((rows, cols), dtype=np.int16),
                cleaned=cleaned,
                values=np.where(cleaned, np.float32(0.5), np.float32(-0.2)),
                positions=[divmod(step % (rows * cols), cols)],
                step=step,
                coverage=float(cleaned.mean()),
            )
        )
    return frames


def frames_of(path) -> list[np.ndarray]:
    with Image.open(path) as gif:
        frames = []
        for index in range(gif.n_frames):
            gif.seek(index)
            frames.append(np.asarray(gif.convert("RGB")).astype(int))
        return frames


def colour(frame: np.ndarray, rows: int, cols: int, panel: int, place: tuple[int, int]):
    row, col = Layout(rows, cols, fitting_cell(rows, cols, PANEL_PIXELS)).centre(panel, place)
    return frame[int(row), int(col)]


@pytest.mark.parametrize(("rows", "cols"), [(3, 7), (7, 3)])
def test_each_frame_shows_its_moment(tmp_path, rows, cols):
    write_gif(tmp_path / "replay.gif", moments(5, rows, cols))
    frames = frames_of(tmp_path / "replay.gif")
    assert len(frames) == 5
    for step, frame in enumerate(frames):
        for panel, dirty in ((0, viewer.DIRTY), (1, viewer.UNKNOWN)):
            corner = (rows - 1, cols - 1)
            assert np.abs(colour(frame, rows, cols, panel, corner) - dirty).max() <= 8
            if step > 0:
                assert np.abs(colour(frame, rows, cols, panel, (0, 0)) - viewer.CLEAN).max() <= 8
    assert [file.name for file in tmp_path.iterdir()] == ["replay.gif"]


@pytest.mark.slow
def test_a_large_one_leaves_out_moments_but_neither_the_first_nor_the_last(tmp_path):
    write_gif(tmp_path / "whole.gif", moments(20))
    limit = (tmp_path / "whole.gif").stat().st_size // 3
    write_gif(tmp_path / "small.gif", moments(20), max_bytes=limit)
    assert (tmp_path / "small.gif").stat().st_size <= limit
    whole, small = frames_of(tmp_path / "whole.gif"), frames_of(tmp_path / "small.gif")
    assert 2 <= len(small) < 10
    assert np.array_equal(small[0], whole[0]) and np.array_equal(small[-1], whole[-1])


@pytest.mark.parametrize("count", [1, 4, 5, 6, 13])
def test_a_long_episode_is_thinned_as_it_comes(monkeypatch, count):
    monkeypatch.setattr(replay, "MOST_FRAMES", 4)
    pictures = drawn(iter(moments(count)))
    assert len(pictures) <= 5
    assert pictures[-1].tobytes() == drawn(moments(count)[-1:])[0].tobytes()


def test_the_same_episode_gives_the_same_file(tmp_path):
    for name in ("one.gif", "two.gif"):
        write_gif(tmp_path / name, moments(4))
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()


def test_cells_fit_small_and_large_houses():
    sides = [(3, 7), (60, 60), (400, 90)]
    assert [fitting_cell(*shape, PANEL_PIXELS) for shape in sides] == [24, 5, 1]
