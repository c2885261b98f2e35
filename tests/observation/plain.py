"""What robots see, in plain Python over the plain world: slow, cell by cell, exact."""

from fractions import Fraction
from itertools import product

from tests.reference import BLOCKED, DIRECTIONS, JUST_CLEANED, ROBOT, UNKNOWN, Place, World
from tests.world.strategies import plain_bits

PLACE = 6  # `Purpose.PLACE`, by its number
COMPASS = [(-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)]


def believed(world: World, robot: int, noise: float, env_index: int = 0, seed: int = 0) -> Place:
    """Where the robot thinks it is, in episode 0."""
    words = seed, env_index, 0, PLACE, world.steps, robot
    row, col = world.positions[robot]
    if plain_bits(*words, 0) >= round(noise * 2**32):
        return row, col
    down, right = DIRECTIONS[plain_bits(*words, 1) * 4 >> 32]
    return min(max(row + down, 0), world.rows - 1), min(max(col + right, 0), world.cols - 1)


def square(world: World, robot: int, centre: Place, side: int) -> list[list[float]]:
    """The square of the robot's map around a place."""
    seen, reach = world.seen(robot), range(-(side // 2), side // 2 + 1)
    return [
        [float(seen.get((centre[0] + down, centre[1] + right), UNKNOWN)) for right in reach]
        for down in reach
    ]


def coarse_planes(world: World, robot: int, centre: Place, side: int, scale: int) -> list:
    """Blocked, unknown, dirt, robots of one coarse scale, [4][side][side]."""
    seen, cells = world.seen(robot), 2**scale
    planes = [[[0.0] * side for _ in range(side)] for _ in range(4)]
    for row, col in product(range(side), repeat=2):
        total = [Fraction(0)] * 3
        for down, right in product(range(cells + 1), repeat=2):
            # From the middle of one border to the middle of the other: those cells count half.
            weight = Fraction(1, cells**2)
            weight /= 2 ** ((down in (0, cells)) + (right in (0, cells)))
            place = (
                centre[0] + (row - side // 2) * cells - cells // 2 + down,
                centre[1] + (col - side // 2) * cells - cells // 2 + right,
            )
            code = seen.get(place, UNKNOWN)
            total[0] += weight * (code == BLOCKED)
            total[1] += weight * (code == UNKNOWN)
            total[2] += weight * (1 - code / JUST_CLEANED if 0 <= code <= JUST_CLEANED else 0)
            if code == ROBOT:
                planes[3][row][col] = 1.0
        for plane, share in zip(planes, total, strict=False):
            plane[row][col] = float(share)
    return planes


def distances(world: World, robot: int, range_cells: int) -> list[float]:
    """Free cells before the first blocked one, in eight directions, over the reach."""
    shares = []
    for down, right in COMPASS:
        row, col = world.positions[robot]
        count = 0
        while count < range_cells and world.is_free((row + down, col + right)):
            row, col, count = row + down, col + right, count + 1
        shares.append(count / range_cells)
    return shares


def whole(world: World, robot: int, largest_side: int) -> list:
    """The map with its ring, unknown below and to the right; and the robot's own place."""
    seen, line = world.seen(robot), range(-1, largest_side + 1)
    known = [[float(seen.get((row, col), UNKNOWN)) for col in line] for row in line]
    own = [[float((row, col) == world.positions[robot]) for col in line] for row in line]
    return [known, own]
