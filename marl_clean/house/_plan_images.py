"""Images of floor plans as shades and colours: of bounded size, and a failure is one plain line.

All limits are checked before anything is decoded. Torch-free.
"""

import io
import struct
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from marl_clean.errors import BadInput
from marl_clean.house._plan_files import LARGEST_FILE_BYTES
from marl_clean.settings import LARGEST_SIDE
from marl_clean.storage.reading import read_bytes

IMAGE_FORMATS = ("PNG", "PPM", "BMP", "JPEG")
STRIP_ROWS = 256
WHITE = 3 * 255  # a shade is red + green + blue, so that grey g / 255 is exactly shade / WHITE
SAME_COLOUR = 8  # of 255 in each channel: what a JPEG adds to a colour
GREYISH = 16  # of 255 between the channels: paper and scans are no purer than that
# What Pillow raises for damaged files, besides OSError for most of them.
DAMAGED = (OSError, ValueError, SyntaxError, EOFError, IndexError, struct.error, zlib.error)
TOO_LARGE = (Image.DecompressionBombWarning, Image.DecompressionBombError)


@dataclass(frozen=True)
class Pixels:
    """An image, row 0 at the top: all arrays are [height, width].

    `shade` uint16, 0 black to 765 white; `opaque` bool; `chosen` bool, whether a pixel has one
    of the colours asked for; `mostly_coloured`: more than half of the opaque pixels are not grey.
    """

    shade: np.ndarray
    opaque: np.ndarray
    chosen: np.ndarray
    mostly_coloured: bool


def read_pixels(file: Path, colours: Sequence[Sequence[int]] = ()) -> Pixels:
    """The image in `file`; `colours` are the (red, green, blue) that are `chosen`.

    Raises BadInput for a file that is no image, is damaged, or is larger than the limits.
    """
    content = io.BytesIO(read_bytes(file, LARGEST_FILE_BYTES))
    with _one_line(file):
        image = Image.open(content, formats=IMAGE_FORMATS)  # the header only
    if max(image.size) > LARGEST_SIDE:
        raise BadInput(
            f"{file}: {image.size[1]} x {image.size[0]} pixels (height x width); "
            f"at most {LARGEST_SIDE} a side are read"
        )
    with _one_line(file):
        return _pixels(image, colours)


@contextmanager
def _one_line(file: Path) -> Iterator[None]:
    """Turns errors of Pillow into BadInput, and silences its warnings."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            yield
    except TOO_LARGE as error:
        raise BadInput(f"{file}: at most {LARGEST_SIDE} pixels a side are read") from error
    except DAMAGED as error:
        formats = ", ".join(IMAGE_FORMATS)
        raise BadInput(f"{file}: not an image, or a damaged one; valid: {formats}") from error


def _pixels(image: Image.Image, colours: Sequence[Sequence[int]]) -> Pixels:
    if image.mode == "F":
        raise ValueError("an image of floats")
    width, height = image.size
    opaque = np.ones((height, width), dtype=bool)
    chosen = np.zeros((height, width), dtype=bool)
    if image.mode.startswith("I"):  # 16 bits
        grey = np.asarray(image).astype(np.int64).clip(0, 65535)
        for colour in colours:
            chosen |= _is_colour(grey[..., None] // 257, colour)
        return Pixels((grey * WHITE // 65535).astype(np.uint16), opaque, chosen, False)
    shade = np.empty((height, width), dtype=np.uint16)
    num_coloured = 0
    for top in range(0, height, STRIP_ROWS):  # four bytes a pixel only for a strip at a time
        strip = slice(top, min(top + STRIP_ROWS, height))
        part = np.asarray(image.crop((0, strip.start, width, strip.stop)).convert("RGBA"))
        red, green, blue, alpha = np.moveaxis(part, 2, 0)
        np.add(red, green, out=shade[strip], dtype=np.uint16)
        shade[strip] += blue
        np.equal(alpha, 255, out=opaque[strip])
        lightest = np.maximum(np.maximum(red, green), blue)
        darkest = np.minimum(np.minimum(red, green), blue)
        coloured = (lightest - darkest > GREYISH) & opaque[strip]
        num_coloured += int(np.count_nonzero(coloured))
        for colour in colours:
            chosen[strip] |= _is_colour(part[..., :3].astype(np.int16), colour)
    mostly_coloured = 2 * num_coloured > int(np.count_nonzero(opaque))
    return Pixels(shade, opaque, chosen, mostly_coloured)


def _is_colour(rgb: np.ndarray, colour: Sequence[int]) -> np.ndarray:
    """Whether every channel is within SAME_COLOUR, bool [height, width]."""
    return (np.abs(rgb - np.array(colour)) <= SAME_COLOUR).all(axis=2)
