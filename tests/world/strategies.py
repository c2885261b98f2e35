"""Hypothesis strategies: small connected houses, robots, every reading, furniture, and a play.

A `Case` is plain data, so that the reference and the tensor world are built from the same one.
Everything is valid by construction; nothing is drawn and thrown away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import product

from hypothesis import strategies as st

from marl_clean.settings import Cases, Decay, Knowledge, Memory, ObstaclePay, PaidBy, Sensor
from tests.reference import (
    UNKNOWN,
    Grid,
    Pieces,
    Place,
    Settings,
    Told,
    World,
    free_places,
    shift_piece,
    walking_distances,
)

MAX_STEPS_PLAYED = 40
MAX_AGENTS = 6
MOST_AGENTS = 8  # of any case: lists with an entry for each robot are as long
LONGEST_PLAY = 100  # above every number of steps that a test plays a case for
BUMP, SPILL = 5, 8  # of `Purpose`, by their numbers: published results hang on them

SHAPES = [(1, 2), (2, 3), (3, 7), (7, 3), (1, 9), (9, 1), (4, 4), (6, 5), (5, 8), (8, 8)]
shapes = st.one_of(
    st.sampled_from(SHAPES),
    st.tuples(st.integers(3, 8), st.integers(3, 8)),
)


@dataclass(frozen=True)
class Case:
    """One world and what is played in it, as plain data.

    `moves` are (step, piece, direction) with step 1 the first that robots take; `memorised` is
    the layout that a stale map believes in, None where that is the true one.
    """

    free: Grid
    furniture: Pieces
    starts: list[Place]
    settings: Settings
    moves: list[tuple[int, int, int]]
    memorised: Grid | None
    actions: list[list[int]]

    def world(self, env_index: int = 0) -> World:
        """The plain world; which bumps are missed depends on the place in the batch (seed 0)."""
        return World(
            self.free,
            self.starts,
            self.settings,
            self.furniture,
            self.moves,
            self.memorised,
            missed_bumps(self.settings.bump_noise, env_index, len(self.starts)),
            spills(self.settings.spills, env_index, self.free, len(self.starts)),
            partial(told, env_index, len(self.starts))
            if self.settings.patches == "coded"
            else None,
        )


def missed_bumps(
    probability: float, env_index: int, n_agents: int, episode: int = 0
) -> set[tuple[int, int]]:
    """Every (step, robot) of a case at which a bump goes unnoticed, by the world's own draw."""
    if probability == 0:
        return set()
    threshold = round(probability * 2**32)
    return {
        (step, robot)
        for step, robot in product(range(LONGEST_PLAY), range(n_agents))
        if plain_bits(0, env_index, episode, BUMP, step, robot) < threshold
    }


def spills(
    count: int, env_index: int, free: Grid, n_agents: int, episode: int = 0, seed: int = 0
) -> dict[int, int]:
    """The world's own draws of a case's spills: by step, the number that decides on the cell."""
    last = max(1, len(free_places(free)) // n_agents - 1)
    drawn = {}
    for spill in range(count):
        first, end = spill * last // count, (spill + 1) * last // count
        if end > first:
            word = plain_bits(seed, env_index, episode, SPILL, 2 * spill)
            step = 1 + first + (word * (end - first) >> 32)
            drawn[step] = plain_bits(seed, env_index, episode, SPILL, 2 * spill + 1)
    return drawn


def told(env_index: int, n_agents: int, step: int) -> Told:
    """What a policy makes of messages in a step, at random: most cells unknown, some edges dead."""
    robots = range(n_agents)
    words = [[plain_bits(1, env_index, step, i, cell) >> 24 for cell in range(49)] for i in robots]
    edges = [[plain_bits(2, env_index, step, i, j) % 3 > 0 for j in robots] for i in robots]
    return [[max(0, word - 252) for word in line] for line in words], edges


def plain_bits(seed: int, *words: int) -> int:
    """The world's hash ("lowbias32", chained over the words) in plain integers."""

    def mix(word: int) -> int:
        for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
            word = (word ^ word >> shift) * factor % 2**32
        return word ^ word >> 16

    state = mix(mix(seed % 2**32) ^ seed >> 32)
    for word in words:
        state = mix(state ^ word)
    return state


def is_connected(free: set[Place]) -> bool:
    return len(walking_distances(free, min(free))) == len(free)


def grid(free: set[Place], rows: int, cols: int) -> Grid:
    return [[(row, col) in free for col in range(cols)] for row in range(rows)]


def several(places: list[Place], at_most: int, at_least: int = 0) -> st.SearchStrategy:
    """Distinct places, every number of them alike (plain lists are mostly short)."""
    return st.integers(at_least, at_most).flatmap(
        lambda size: st.lists(st.sampled_from(places), unique=True, min_size=size, max_size=size)
    )


@st.composite
def houses(draw: st.DrawFn, max_pieces: int = 3) -> tuple[Grid, Pieces]:
    """(free, furniture): one region of at least two free cells, pieces and walls at random.

    Each piece and each wall is kept only if the free cells stay one region.
    """
    rows, cols = draw(shapes)
    free = {(row, col) for row in range(rows) for col in range(cols)}
    furniture = [[0] * cols for _ in range(rows)]
    for number in range(1, draw(st.integers(0, max_pieces)) + 1):
        top, left = draw(st.sampled_from(sorted(free)))
        height, width = draw(st.tuples(st.integers(1, 2), st.integers(1, 3)))
        piece = {(top + down, left + right) for down in range(height) for right in range(width)}
        if piece < free and len(free - piece) >= 2 and is_connected(free - piece):
            free -= piece
            for row, col in piece:
                furniture[row][col] = number
    for wall in draw(several(sorted(free), len(free) // 3)):
        if len(free) > 2 and is_connected(free - {wall}):
            free.remove(wall)
    return grid(free, rows, cols), furniture


@st.composite
def settings(draw: st.DrawFn) -> Settings:
    """Every reading; short decays and limits, so that 40 steps meet them."""
    memory = draw(st.sampled_from(Memory))
    knowledge: st.SearchStrategy = st.sampled_from(Knowledge)
    if memory is not Memory.SHARED:
        each = st.tuples(*[st.sampled_from(Knowledge)] * MOST_AGENTS)
        knowledge = st.one_of(knowledge, each)
    shown = draw(st.sampled_from([True, True, False]))
    return Settings(
        memory=memory,
        knowledge=draw(knowledge),
        sensor=draw(st.sampled_from(Sensor)),
        decay_steps=draw(st.one_of(st.integers(1, 16), st.sampled_from([200, None]))),
        decay=draw(st.sampled_from(Decay)),
        uncleaned_at_most=draw(
            st.sampled_from([Fraction(0), Fraction(1, 10), Fraction(1, 4), Fraction(499, 1000)])
        ),
        unknown_value=draw(st.sampled_from([UNKNOWN, Fraction(0)])),
        cases=draw(st.sampled_from(Cases)),
        obstacles=draw(st.sampled_from(ObstaclePay)),
        wall_pays=draw(st.sampled_from([2, 2, Fraction(1, 2), 0])),
        paid_by=draw(st.sampled_from(PaidBy)),
        collision_pays=draw(st.sampled_from([0, 0, Fraction(-1, 2), -3])),
        robots_shown=shown,
        robots_noted=shown and memory is Memory.PRIVATE and draw(st.booleans()),
        shaping=draw(st.sampled_from([0, 0, Fraction(1, 2)])),
        spills=draw(st.sampled_from([0, 0, 1, 3, 8])),
        spill_size=draw(st.integers(1, 4)),
        spill_noticed_within=draw(st.sampled_from([None, 0, 1, 2, 4, 9])),
        spill_pays=draw(st.sampled_from([2, Fraction(1, 2), 0])),
        bump_noise=draw(st.sampled_from([0.0, 0.0, 0.3, 1.0])),
        max_steps=draw(st.sampled_from([None, None, None, 7, MAX_STEPS_PLAYED])),
        stuck_after=draw(st.sampled_from([None, None, 100, 20, 8])),
        view_size=draw(st.sampled_from([1, 3, 5, 7, 15])),
        topology=draw(st.sampled_from(["view", "radius", "sight", "full", "none"])),
        radius_cells=draw(st.one_of(st.none(), st.integers(0, 6))),
        reward=draw(st.sampled_from(["individual", "neighbours", "team"])),
    )


def joint_actions(n_agents: int, max_steps: int = MAX_STEPS_PLAYED) -> st.SearchStrategy:
    """A list of steps, each one action a robot; robot 0 is the lowest base-4 digit of a draw."""

    def digits(joint: int) -> list[int]:
        return [joint >> 2 * robot & 3 for robot in range(n_agents)]

    joint = st.integers(0, 4**n_agents - 1).map(digits)
    lengths = st.sampled_from([1, 5, max_steps // 2, max_steps, max_steps])
    return lengths.flatmap(lambda steps: st.lists(joint, min_size=steps, max_size=steps))


def shifted(
    free: Grid, furniture: Pieces, shifts: Sequence[tuple[int, int]]
) -> tuple[Grid, Pieces]:
    """The layout after (piece, direction) shifts with no robot about; forbidden ones skipped."""
    for piece, direction in shifts:
        free, furniture = shift_piece(free, furniture, piece, direction, ()) or (free, furniture)
    return free, furniture


@st.composite
def cases(
    draw: st.DrawFn,
    settings: st.SearchStrategy[Settings] = settings(),  # noqa: B008 - strategies are immutable
    max_agents: int = MAX_AGENTS,
    furniture_moves: bool = True,
) -> Case:
    """A whole play: house, robots (fewer than free cells), settings, furniture moves, actions."""
    readings = draw(settings)
    free, furniture = draw(houses())
    pieces = max(map(max, furniture))
    shift = st.tuples(st.integers(1, max(pieces, 1)), st.integers(0, 3))
    memorised = None
    if readings.any_stale and pieces:
        memorised = free
        free, furniture = shifted(free, furniture, draw(st.lists(shift, min_size=3, max_size=6)))
    places = sorted(free_places(free))
    starts = draw(several(places, min(max_agents, len(places) - 1), at_least=1))
    moves: list[tuple[int, int, int]] = []
    if furniture_moves and pieces and draw(st.booleans()):
        timed = st.tuples(st.integers(1, MAX_STEPS_PLAYED // 2), shift)
        moves = [(step, *move) for step, move in draw(st.lists(timed, min_size=4, max_size=16))]
    actions = draw(joint_actions(len(starts)))
    return Case(free, furniture, starts, readings, moves, memorised, actions)
