"""`replay.gif`: one episode, the truth beside the robots' map."""

import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from omegaconf import DictConfig
from PIL import Image

from marl_clean.env.viewer import Scene, draw, fitting_cell
from marl_clean.evaluation.evaluator import PolicyFor
from marl_clean.report.episode import first_held_out, scenes
from marl_clean.storage import files

MAX_BYTES = 2_000_000
MOST_FRAMES = 256  # bounds the memory too: all are held until their palette is known
COLOURS = 64
FRAME_MILLISECONDS = 100
LAST_FRAME_MILLISECONDS = 2_500  # time to read the end before it starts again
PANEL_PIXELS = 320  # the longer side of a panel, about


def make_replay(cfg: DictConfig, policy_for: PolicyFor, path: Path, epsilon: float = 0.0) -> None:
    """Write an episode in the first held-out house of `cfg` to `path` as a GIF below 2 MB."""
    write_gif(path, scenes(first_held_out(cfg), policy_for, epsilon))


def write_gif(path: Path, episode: Iterable[Scene], max_bytes: int = MAX_BYTES) -> None:
    """Write the scenes as a GIF, or every k-th of them if they are many or the file is too large.

    The first and the last are always shown. The file appears whole or not at all.
    """
    pictures = coded(drawn(episode))
    stride = 1
    while True:
        shown = [*pictures[:-1:stride], pictures[-1]]
        content = encoded(shown)
        if len(content) <= max_bytes or len(shown) <= 2:
            break
        stride = max(stride + 1, -(-stride * len(content) // max_bytes))
    with files.writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_file(path, [content])


def drawn(episode: Iterable[Scene]) -> list[Image.Image]:
    """Pictures of the first scene, of every k-th after it, and of the last; k grows on the way."""
    pictures: list[Image.Image] = []
    stride = 1
    left_out = None  # the newest scene, if it has no picture
    for index, scene in enumerate(episode):
        left_out = scene if index % stride else None
        if left_out is None:
            pictures.append(picture_of(scene))
        if len(pictures) > MOST_FRAMES:
            pictures, stride = pictures[::2], 2 * stride
    return pictures if left_out is None else [*pictures, picture_of(left_out)]


def picture_of(scene: Scene) -> Image.Image:
    """One frame, its cells as large as fits a usual width."""
    rows, cols = scene.free.shape
    return Image.fromarray(draw(scene, fitting_cell(rows, cols, PANEL_PIXELS)))


def coded(pictures: Sequence[Image.Image]) -> list[Image.Image]:
    """The pictures in one palette, so that colours do not flicker.

    Undithered, so that only what changed is stored.
    """
    width, height = pictures[0].size
    samples = [pictures[0], pictures[len(pictures) // 2], pictures[-1]]
    mosaic = Image.new("RGB", (width, height * len(samples)))
    for index, picture in enumerate(samples):
        mosaic.paste(picture, (0, height * index))
    undithered = Image.Dither.NONE
    palette = mosaic.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=undithered)
    return [picture.quantize(palette=palette, dither=undithered) for picture in pictures]


def encoded(pictures: Sequence[Image.Image]) -> bytes:
    """The pictures as a GIF that starts again at its end."""
    content = io.BytesIO()
    pictures[0].save(
        content,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[FRAME_MILLISECONDS] * (len(pictures) - 1) + [LAST_FRAME_MILLISECONDS],
        loop=0,
        optimize=False,
    )
    return content.getvalue()
