"""Damaged plan files are either read or refused in one line; nothing else ever happens."""

import io
import random
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from marl_clean.errors import BadInput
from marl_clean.house.base import House, draw_houses
from marl_clean.house.drawn import SHIPPED, Drawn
from marl_clean.house.floorplan import FloorPlan

TRIALS = 150
PIECES = (b"0", b"-1", b"999999999", b"\n", b"\0", b"\xff", b"[", b"{", b": ", b"&a ", b"*a", b"#")
PIECES += (b"!!int ", b"nan", b"1e999", b"\t", b"- ", b"../", b"%", b"<<: ", b"? ", b"'", b'"')


def as_image(kind: str) -> bytes:
    content = io.BytesIO()
    Image.open(SHIPPED / "apartment.pgm").convert("RGBA" if kind == "PNG" else "L").save(
        content, kind
    )
    return content.getvalue()


def as_movingai() -> bytes:
    free = Drawn().layout().free
    rows = ["".join(np.where(row, ".", "@")) for row in free]
    head = ["type octile", f"height {free.shape[0]}", f"width {free.shape[1]}", "map"]
    return "\n".join(head + rows).encode()


ORIGINALS = {
    ".txt": (SHIPPED / "apartment.txt").read_bytes(),
    ".yaml": (SHIPPED / "apartment.yaml").read_bytes(),
    ".pgm": (SHIPPED / "apartment.pgm").read_bytes(),
    ".png": as_image("PNG"),
    ".bmp": as_image("BMP"),
    ".jpg": as_image("JPEG"),
    ".map": as_movingai(),
}


def mutated(original: bytes, numbers: random.Random) -> bytes:
    """One to four times: a byte changed, a stretch cut or repeated, a piece put in, the end cut."""
    content = bytearray(original)
    for _ in range(numbers.randint(1, 4)):
        # Half of the damage falls on the header.
        at = numbers.randrange(min(len(content), numbers.choice((80, len(content)))) + 1)
        kind = numbers.randrange(5)
        if kind == 0:
            content[at : at + 1] = bytes([numbers.randrange(256)])
        elif kind == 1:
            del content[at : at + numbers.randint(1, 40)]
        elif kind == 2:
            content[at:at] = content[at : at + 30] * numbers.randint(1, 20)
        elif kind == 3:
            content[at:at] = numbers.choice(PIECES)
        else:
            del content[max(at, 1) :]
        content = content or bytearray(b"#")
    return bytes(content)


@pytest.mark.parametrize("suffix", ORIGINALS)
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "apartment.pgm").write_bytes(ORIGINALS[".pgm"])
    file = tmp_path / f"plan{suffix}"
    house: House = Drawn(str(file)) if suffix == ".txt" else FloorPlan(str(file))
    numbers = random.Random(f"damage to {suffix}")
    refused = 0
    for _ in range(TRIALS):
        file.write_bytes(mutated(ORIGINALS[suffix], numbers))
        try:
            houses = draw_houses(house, [0], n_agents=2)
        except BadInput as error:
            refused += 1
            assert "\n" not in str(error) and "plan" in str(error)
        else:
            assert houses.free_cells[0] > 2
    assert 0 < refused < TRIALS  # the damage is neither nothing nor everything


def test_the_originals_are_all_the_same_house(tmp_path: Path) -> None:
    (tmp_path / "apartment.pgm").write_bytes(ORIGINALS[".pgm"])
    drawn = Drawn().layout().free
    for suffix, content in ORIGINALS.items():
        file = tmp_path / f"plan{suffix}"
        file.write_bytes(content)
        pixel_metres = 0.1 if suffix in (".pgm", ".png", ".bmp", ".jpg") else None
        house = FloorPlan(str(file), pixel_metres=pixel_metres)
        plan = (Drawn(str(file)) if suffix == ".txt" else house).layout()
        np.testing.assert_array_equal(plan.free, drawn)
