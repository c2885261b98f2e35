"""A sheet of houses as one picture, to judge by eye: `python -m tests.house.sheet OUT.png`."""

import sys

import numpy as np
from PIL import Image

from marl_clean.house.base import HouseLayout, split_seeds
from marl_clean.house.rooms import Rooms

WALL, FLOOR = (60, 60, 70), (245, 240, 230)
FURNITURE = ((190, 140, 90), (150, 165, 110), (170, 120, 120), (120, 140, 170))
CELL_PIXELS, GAP_PIXELS = 14, 12


def picture(layout: HouseLayout) -> np.ndarray:
    """One house from above, uint8 [rows * CELL_PIXELS, cols * CELL_PIXELS, 3]."""
    colours = np.where(layout.free[..., None], FLOOR, WALL)
    pieces = np.array(FURNITURE)[layout.furniture % len(FURNITURE)]
    colours = np.where(layout.furniture[..., None] > 0, pieces, colours)
    return colours.astype(np.uint8).repeat(CELL_PIXELS, axis=0).repeat(CELL_PIXELS, axis=1)


def sheet(layouts: list[HouseLayout], across: int) -> Image.Image:
    """The houses in rows of `across`, on white."""
    pictures = [picture(layout) for layout in layouts]
    height = max(each.shape[0] for each in pictures) + GAP_PIXELS
    width = max(each.shape[1] for each in pictures) + GAP_PIXELS
    down = -(-len(layouts) // across)
    page = np.full((down * height + GAP_PIXELS, across * width + GAP_PIXELS, 3), 255, np.uint8)
    for index, each in enumerate(pictures):
        top = GAP_PIXELS + index // across * height
        left = GAP_PIXELS + index % across * width
        page[top : top + each.shape[0], left : left + each.shape[1]] = each
    return Image.fromarray(page)


if __name__ == "__main__":
    small, large = Rooms([10, 10], [10, 10]), Rooms([14, 14], [14, 14])
    houses = [house.layout(seed) for house in (small, large) for seed in split_seeds("test", 12)]
    sheet(houses, across=6).save(sys.argv[1])
