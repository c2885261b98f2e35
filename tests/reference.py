"""The world, two planners and the measures in plain Python: what the tensor code must equal.

Slow on purpose, one world at a time, exact (integers and fractions), in the order of the rules:
settings, map, world and its step, planner, measures. Section numbers are the paper's.
A place is (row, col) of the house; the ring around it lies in rows -1 and R, columns -1 and C.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from itertools import product
from typing import Any, Literal

from marl_clean.settings import (
    Assignment,
    Cases,
    Decay,
    Knowledge,
    Memory,
    ObstaclePay,
    PaidBy,
    Sensor,
)

Place = tuple[int, int]
Grid = list[list[bool]]
Pieces = list[list[int]]
Told = tuple[list[list[int]], list[list[bool]]]  # by sender 49 classes; [hearer][sender]: heard

UP, RIGHT, DOWN, LEFT = range(4)
DIRECTIONS = ((-1, 0), (0, 1), (1, 0), (0, -1))

HALF = Fraction(1, 2)
ROBOT = Fraction(1)
JUST_CLEANED = HALF
DIRTY = Fraction(0)
UNKNOWN = Fraction(-1, 5)
BLOCKED = Fraction(-1)


def exact(number: Fraction | float) -> Fraction:
    """The decimal that was written: 0.1 is 1/10, not its nearest binary float."""
    return Fraction(str(number))


def neighbour(place: Place, direction: int) -> Place:
    return place[0] + DIRECTIONS[direction][0], place[1] + DIRECTIONS[direction][1]


def neighbours(place: Place) -> list[Place]:
    return [neighbour(place, direction) for direction in range(4)]


@dataclass(frozen=True)
class Settings:
    """Every reading of the rules; the defaults are the rule page's."""

    memory: Memory = Memory.SHARED
    knowledge: Knowledge | tuple[Knowledge, ...] = Knowledge.UNKNOWN  # one for all, or one a robot
    sensor: Sensor = Sensor.BUMP
    decay_steps: int | None = 200  # None: what is clean stays clean
    decay: Decay = Decay.FORMULA
    uncleaned_at_most: Fraction | float = 0  # in [0, 0.5): a cell counts as uncleaned iff v <= it
    unknown_value: Fraction | float = UNKNOWN  # v of an unknown cell: -0.2 or 0
    cases: Cases = Cases.ADD
    obstacles: ObstaclePay = ObstaclePay.FIRST
    wall_pays: Fraction | float = 2  # what learning of a wall pays
    paid_by: PaidBy = PaidBy.OWN_MAP
    collision_pays: Fraction | float = 0  # what a collision adds to the own reward
    robots_shown: bool = True
    robots_noted: bool = False
    shaping: Fraction | float = 0  # w of the shaping term w (gamma phi' - phi)
    gamma: Fraction | float = Fraction(7, 8)  # the learner's
    spills: int = 0  # an episode; when and where is drawn elsewhere, and handed to the world
    spill_size: int = 2
    spill_noticed_within: int | None = None  # steps on foot; None: all robots notice it
    spill_pays: Fraction | float = 2
    bump_noise: float = 0.0  # who misses which bump is drawn elsewhere, and handed to the world
    max_steps: int | None = None  # None: 4 * R * C // n_agents + 50
    stuck_after: int | None = 100  # None: off
    view_size: int = 15
    topology: Literal["view", "radius", "sight", "full", "none"] = "view"
    radius_cells: Fraction | float | None = None  # None: the view's half
    reward: Literal["individual", "neighbours", "team"] = "individual"
    exchange_cells: int | None = None  # of private maps, that a robot tells another in a step
    lends: bool = False  # robots in contact see by the union of their private maps
    patches: Literal["all", "cleaned", "blocked", "coded"] | None = None  # heard by contacts

    @property
    def decay_per_step(self) -> Fraction:
        if self.decay_steps is None:
            return Fraction(0)
        return Fraction(1 if self.decay is Decay.FORMULA else HALF, self.decay_steps)

    @property
    def dirty_age(self) -> float:
        """A cell is dirty when its age >= ceil(0.5 / decay); without decay at no age."""
        if self.decay_steps is None:
            return math.inf
        return math.ceil(JUST_CLEANED / self.decay_per_step)

    def knowledge_of(self, robot: int) -> Knowledge:
        return self.knowledge if isinstance(self.knowledge, str) else self.knowledge[robot]

    @property
    def any_stale(self) -> bool:
        known = self.knowledge
        return Knowledge.STALE in ([known] if isinstance(known, str) else known)

    @property
    def radius(self) -> Fraction:
        return exact(self.view_size // 2 if self.radius_cells is None else self.radius_cells)


# --------------------------------------------------------------------------- the map (§3.2)


@dataclass(frozen=True)
class Record:
    """What a map holds of a known cell; a cell without a record is unknown."""

    blocked: bool
    written: int  # the step at which it was written
    cleaned: int | None = None  # the step at which it was last cleaned, as far as the map knows
    spilt: bool = False  # dirty because of a spill, as far as the map knows


Map = dict[Place, Record]


def value(record: Record | None, now: int, settings: Settings) -> Fraction:
    """-1 blocked, -0.2 unknown, 0.5 just cleaned, falling by the decay, never below 0."""
    if record is None:
        return UNKNOWN
    if record.blocked:
        return BLOCKED
    if record.cleaned is None or now - record.cleaned >= settings.dirty_age:
        return DIRTY
    return JUST_CLEANED - (now - record.cleaned) * settings.decay_per_step


def union(one: Map, other: Map) -> Map:
    """The later record wins, of equals blocked wins (and of two available ones the cleaned)."""

    def strength(record: Record) -> tuple[int, bool, bool, bool]:
        return record.written, record.blocked, record.cleaned is not None, record.spilt

    united = dict(one)
    for place, record in other.items():
        if place not in united or strength(record) > strength(united[place]):
            united[place] = record
    return united


# --------------------------------------------------------------------------- the true house


def free_places(free: Grid) -> set[Place]:
    return {(row, col) for row, line in enumerate(free) for col, cell in enumerate(line) if cell}


def walking_distances(free: set[Place], start: Place) -> dict[Place, int]:
    """Steps on foot from `start` to each free place it reaches, as if no robot were in the way."""
    distances, queue = {start: 0}, deque([start])
    while queue:
        place = queue.popleft()
        for reached in neighbours(place):
            if reached in free and reached not in distances:
                distances[reached] = distances[place] + 1
                queue.append(reached)
    return distances


def shift_piece(
    free: Grid, furniture: Pieces, piece: int, direction: int, occupied: Iterable[Place]
) -> tuple[Grid, Pieces] | None:
    """The layout with one piece of furniture one cell further, None where that is not allowed.

    Not allowed: out of the house's rectangle, into a wall, another piece or a robot, or free cells
    that would no longer be one region.
    """
    lines = list(enumerate(furniture))
    old = {(row, col) for row, line in lines for col, cell in enumerate(line) if cell == piece}
    new = {neighbour(place, direction) for place in old}
    before = free_places(free)
    if not old or not new <= (before - set(occupied)) | old:
        return None
    after = (before | old) - new
    if not after or len(walking_distances(after, min(after))) < len(after):
        return None
    shape = range(len(free)), range(len(free[0]))
    other = {place: furniture[place[0]][place[1]] for place in product(*shape) if place not in old}
    pieces = [
        [piece if (row, col) in new else other.get((row, col), 0) for col in shape[1]]
        for row in shape[0]
    ]
    return [[(row, col) in after for col in shape[1]] for row in shape[0]], pieces


def in_sight(free: set[Place], one: Place, other: Place) -> bool:
    """The open segment between two cells' centres meets no blocked cell's interior."""
    rows = range(min(one[0], other[0]), max(one[0], other[0]) + 1)
    cols = range(min(one[1], other[1]), max(one[1], other[1]) + 1)
    return not any(crosses(one, other, place) for place in product(rows, cols) if place not in free)


def crosses(one: Place, other: Place, cell: Place) -> bool:
    """Some point one + t (other - one), 0 < t < 1, lies strictly inside the cell."""
    enter, leave = Fraction(0), Fraction(1)
    for begin, end, centre in zip(one, other, cell, strict=True):
        if begin == end:
            if begin != centre:
                return False
            continue
        sides = [(centre - begin + half) / (end - begin) for half in (-HALF, HALF)]
        enter, leave = max(enter, min(sides)), min(leave, max(sides))
    return enter < leave


# --------------------------------------------------------------------------- the world


@dataclass(frozen=True)
class Outcome:
    """What one step did, one entry a robot; the flags are the world's."""

    moved: list[bool]
    bumped: list[bool]
    collided: list[bool]
    target: list[Place]
    newly_cleaned: list[bool]
    step: list[Fraction]
    cleaning: list[Fraction]
    discovery: list[Fraction]
    collision: list[Fraction]
    spill: list[Fraction]
    own_reward: list[Fraction]
    shaping: list[Fraction]
    reward: list[Fraction]
    terminated: bool
    truncated: bool


class World:
    """One house with its robots, from step 0 (already cleaned, touched and merged) on.

    `furniture` holds 0 or a piece's number for each cell (blocked in `free`); `moves` are
    (step, piece, direction), step 1 being the first that the robots take; `memorised` is the
    layout that a stale map believes in, the true one otherwise. Robots do not notice a bump at
    the (step, robot) of `missed`, steps counted from 0: it writes nothing and pays nothing.
    `spills` has, for each step at which something is spilt, a number in [0, 2^32) that decides
    which clean cell is hit. `told` returns, for a step counted from 0, what a policy makes of the
    robots' messages under `patches=coded`.
    """

    def __init__(
        self,
        free: Grid,
        starts: Sequence[Place],
        settings: Settings,
        furniture: Pieces | None = None,
        moves: Sequence[tuple[int, int, int]] = (),
        memorised: Grid | None = None,
        missed: Iterable[tuple[int, int]] = (),
        spills: Mapping[int, int] | None = None,
        told: Callable[[int], Told] | None = None,
    ) -> None:
        self.settings = settings
        self.rows, self.cols = len(free), len(free[0])
        self.free = [list(line) for line in free]
        self.furniture = furniture or [[0] * self.cols for _ in range(self.rows)]
        self.moves = list(moves)
        self.missed = set(missed)
        self.spills = dict(spills or {})
        self.told = told
        self.spilt: set[Place] = set()  # and not cleaned since
        self.spill_delays: list[int] = []  # of the cells cleaned again, or covered by furniture
        self.spilt_at: dict[Place, int] = {}  # when each cell of `spilt` was
        self.positions = list(starts)
        self.n_agents = len(self.positions)
        default_steps = 4 * self.rows * self.cols // self.n_agents + 50
        self.max_steps = default_steps if settings.max_steps is None else settings.max_steps
        self.steps = 0
        self.last_first_clean = 0
        self.cleaned: set[Place] = set()  # of the cells free now
        self.stood_on: set[Place] = set()  # ever
        n_maps = 1 if settings.memory is Memory.SHARED else self.n_agents
        before = free_places(self.free if memorised is None else memorised)
        self.maps: list[Map] = [self._first_map(robot, before) for robot in range(n_maps)]
        self.said: list[dict[Place, Any]] = [{} for _ in self.maps]
        self.changed: list[dict[Place, int]] = [{} for _ in self.maps]
        self.heard_from: list[dict[Place, int]] = [{} for _ in self.maps]
        self.told_until: dict[tuple[int, int], tuple[int, Place]] = {}
        self.heard: list[Map] = [{} for _ in self.maps]  # the last that each heard of a cell
        self.exchanged_bits = [0] * self.n_agents
        self._clean()
        self._touch()
        self._merge()
        self._exchange()
        self._lend()
        self._see_by_heard()
        self._note_robots()

    # ---- what is there

    def places(self) -> Iterable[Place]:
        """All cells of the matrix, the ring included, row by row."""
        return product(range(-1, self.rows + 1), range(-1, self.cols + 1))

    def in_matrix(self, place: Place) -> bool:
        return -1 <= place[0] <= self.rows and -1 <= place[1] <= self.cols

    def is_free(self, place: Place) -> bool:
        """Free in truth; the ring is blocked."""
        row, col = place
        return 0 <= row < self.rows and 0 <= col < self.cols and self.free[row][col]

    def map_of(self, robot: int) -> Map:
        return self.maps[0 if self.settings.memory is Memory.SHARED else robot]

    def union_of_maps(self) -> Map:
        united = self.maps[0]
        for other in self.maps[1:]:
            united = union(united, other)
        return united

    def coverage(self) -> tuple[int, int]:
        """(cells free now and cleaned, cells free now)."""
        return len(self.cleaned), len(free_places(self.free))

    def certified(self) -> bool:
        """No unknown cell is a 4-neighbour of a cell some robot has stood on."""
        known = self.union_of_maps()
        return all(near in known for place in self.stood_on for near in neighbours(place))

    # ---- what robots see (§3.2, §3.4)

    def contacts(self) -> list[list[bool]]:
        """The topology's matrix: symmetric, false on the diagonal."""
        robots = range(self.n_agents)
        return [[i != j and self._in_contact(i, j) for j in robots] for i in robots]

    def _in_contact(self, i: int, j: int) -> bool:
        one, other = self.positions[i], self.positions[j]
        down, right = other[0] - one[0], other[1] - one[1]
        near = down**2 + right**2 <= self.settings.radius**2
        match self.settings.topology:
            case "view":
                return max(abs(down), abs(right)) <= self.settings.view_size // 2
            case "radius":
                return near
            case "sight":
                return near and in_sight(free_places(self.free), one, other)
            case "full":
                return True
            case "none":
                return False

    def distance_rank(self) -> list[list[int]]:
        """[i][j]: 0 for i itself, then 1, 2, ... nearest first, ties by (row, col) offset."""

        def order(i: int, j: int) -> tuple[int, int, int]:
            down = self.positions[j][0] - self.positions[i][0]
            right = self.positions[j][1] - self.positions[i][1]
            return down**2 + right**2, down, right

        robots = range(self.n_agents)
        sequences = [sorted(robots, key=partial(order, i)) for i in robots]
        return [[sequence.index(j) for j in robots] for sequence in sequences]

    def seen(self, robot: int) -> dict[Place, Fraction]:
        """The matrix as `robot` sees it: its own cell is 1, and those of the others it sees."""
        known = self.map_of(robot)
        shown = {self.positions[other] for other in (robot, *self.seen_robots(robot))}
        return {
            place: ROBOT if place in shown else value(known.get(place), self.steps, self.settings)
            for place in self.places()
        }

    def seen_robots(self, robot: int) -> list[int]:
        """The others whose place it sees: all on a shared map, else its contacts; or nobody."""
        if not self.settings.robots_shown:
            return []
        contacts = self.contacts()[robot]
        everyone = self.settings.memory is Memory.SHARED
        return [i for i in range(self.n_agents) if i != robot and (everyone or contacts[i])]

    def map_values(self, robot: int) -> list[list[float]]:
        """The paper's matrix, (R+2) x (C+2)."""
        seen = self.seen(robot)
        cols = range(-1, self.cols + 1)
        return [[float(seen[row, col]) for col in cols] for row in range(-1, self.rows + 1)]

    def view(self, robot: int, view_size: int | None = None) -> list[list[float]]:
        """The odd-sided square of the matrix around the robot; what lies outside is unknown."""
        half = (self.settings.view_size if view_size is None else view_size) // 2
        seen, (row, col) = self.seen(robot), self.positions[robot]
        offsets = range(-half, half + 1)
        return [
            [float(seen.get((row + down, col + right), UNKNOWN)) for right in offsets]
            for down in offsets
        ]

    def potential(self, robot: int) -> int:
        """Minus the steps to the nearest unknown or never cleaned cell of the house, by its map.

        Over cells known to be available; -60 where that is farther, or none can be reached.
        """
        known, start = self.map_of(robot), self.positions[robot]
        distances, queue = {start: 0}, deque([start])
        while queue:
            place = queue.popleft()
            for reached in neighbours(place):
                held = known.get(reached)
                row, col = reached
                in_house = 0 <= row < self.rows and 0 <= col < self.cols
                if reached in distances or (held is None and not in_house):
                    continue
                if held is None or (not held.blocked and held.cleaned is None):
                    return -min(60, distances[place] + 1)
                if not held.blocked:
                    distances[reached] = distances[place] + 1
                    queue.append(reached)
        return -60

    def action_mask(self, robot: int) -> list[bool]:
        """By action: whether the robot's map does not hold the neighbour for blocked; else all."""
        held = [self.map_of(robot).get(place) for place in neighbours(self.positions[robot])]
        mask = [record is None or not record.blocked for record in held]
        return mask if any(mask) else [True] * len(DIRECTIONS)

    # ---- one step

    def step(self, actions: Sequence[int]) -> Outcome:
        """All robots act at once; paid by the maps and contacts as they were before."""
        contacts = self.contacts()
        target = [neighbour(p, a) for p, a in zip(self.positions, actions, strict=True)]
        moved = self._who_moves(target)
        bumped = [not self.is_free(place) for place in target]
        collided = [not (m or b) for m, b in zip(moved, bumped, strict=True)]
        robots = range(self.n_agents)
        before = [self.potential(robot) for robot in robots]
        self._hear()
        if self.settings.lends or self.settings.patches:
            self.maps = self.own_maps
        noticed = [bumped[i] and (self.steps, i) not in self.missed for i in robots]
        terms = [self._reward_terms(i, target[i], moved[i], noticed[i]) for i in robots]
        pays = exact(self.settings.spill_pays)
        spill = [
            pays if m and place in self.spilt else Fraction(0)
            for m, place in zip(moved, target, strict=True)
        ]
        costs = exact(self.settings.collision_pays)
        collision = [costs if collided[i] else Fraction(0) for i in robots]
        own_reward = [sum(terms[i], collision[i] + spill[i]) for i in robots]

        self.steps += 1
        for robot in robots:
            if moved[robot]:
                self.positions[robot] = target[robot]
            if noticed[robot]:
                self.map_of(robot)[target[robot]] = Record(blocked=True, written=self.steps)
        newly_cleaned = self._clean()
        self._move_furniture()
        self._close_spills()
        self._spill()
        self._touch()
        self._merge()
        self._exchange()
        self._lend()
        self._see_by_heard()
        self._note_robots()

        terminated = self.cleaned == free_places(self.free)
        after = [0 if terminated else self.potential(robot) for robot in robots]
        weight, gamma = exact(self.settings.shaping), exact(self.settings.gamma)
        shaping = [weight * (gamma * new - old) for old, new in zip(before, after, strict=True)]
        earned = [own + term for own, term in zip(own_reward, shaping, strict=True)]
        step, cleaning, discovery = (list(term) for term in zip(*terms, strict=True))
        return Outcome(
            moved=moved,
            bumped=bumped,
            collided=collided,
            target=target,
            newly_cleaned=newly_cleaned,
            step=step,
            cleaning=cleaning,
            discovery=discovery,
            collision=collision,
            spill=spill,
            own_reward=own_reward,
            shaping=shaping,
            reward=self._shared(earned, contacts),
            terminated=terminated,
            truncated=not terminated and (self.steps >= self.max_steps or self.stuck()),
        )

    def stuck(self) -> bool:
        """No cell cleaned for the first time within `stuck_after` steps."""
        limit = self.settings.stuck_after
        return limit is not None and self.steps - self.last_first_clean >= limit

    def _who_moves(self, target: list[Place]) -> list[bool]:
        """Target free, nobody there when the step began, no lower-numbered robot enters it."""
        entered: set[Place] = set()
        moved = []
        for place in target:
            enters = self.is_free(place) and place not in self.positions and place not in entered
            moved.append(enters)
            if enters:
                entered.add(place)
        return moved

    def _reward_terms(
        self, robot: int, target: Place, moved: bool, bumped: bool
    ) -> tuple[Fraction, Fraction, Fraction]:
        """(step, cleaning, discovery), by the robot's map before the step, or the team's (§3.3)."""
        settings = self.settings
        by_team = settings.paid_by is PaidBy.TEAM_MAP
        held = (self.union_of_maps() if by_team else self.map_of(robot)).get(target)
        held_free = held is not None and not held.blocked
        held_blocked = held is not None and held.blocked
        v = value(held, self.steps, settings) if held_free else exact(settings.unknown_value)
        of_spill = target in self.spilt or (held is not None and held.spilt)
        uncleaned = moved and v <= exact(settings.uncleaned_at_most) and not of_spill
        every = settings.obstacles is ObstaclePay.EVERY
        learnt = (moved and not held_free) or (bumped and (every or not held_blocked))

        step = Fraction(-1)
        cleaning = 2 - 2 * v if uncleaned else Fraction(0)
        pays = Fraction(2) if moved else exact(settings.wall_pays)
        discovery = pays if learnt else Fraction(0)
        if settings.cases is Cases.EXCLUDE and learnt:
            return Fraction(0), Fraction(0), discovery
        if settings.cases is Cases.EXCLUDE and uncleaned:
            return Fraction(0), cleaning, Fraction(0)
        return step, cleaning, discovery

    def _shared(self, own: list[Fraction], contacts: list[list[bool]]) -> list[Fraction]:
        """Who is paid (§3.4): each its own, r_i + those in contact, or the sum to all."""
        match self.settings.reward:
            case "individual":
                return list(own)
            case "neighbours":
                return [
                    pay + sum(others for others, live in zip(own, line, strict=True) if live)
                    for pay, line in zip(own, contacts, strict=True)
                ]
            case "team":
                return [sum(own, Fraction(0))] * self.n_agents

    # ---- what is written, in this order

    def _first_map(self, robot: int, before: set[Place]) -> Map:
        """Nothing, or the whole matrix as memorised, all of it dirty, learnt before step 0.

        A stale map holds the layout `before` the furniture was moved.
        """
        knowledge = self.settings.knowledge_of(robot)
        if knowledge is Knowledge.UNKNOWN:
            return {}
        layout = before if knowledge is Knowledge.STALE else free_places(self.free)
        return {place: Record(blocked=place not in layout, written=-1) for place in self.places()}

    def _clean(self) -> list[bool]:
        """Each robot cleans the cell it stands on; true where nobody had (since it was vacated)."""
        first = [place not in self.cleaned for place in self.positions]
        for robot, place in enumerate(self.positions):
            self.map_of(robot)[place] = Record(False, written=self.steps, cleaned=self.steps)
        self.cleaned.update(self.positions)
        self.stood_on.update(self.positions)
        if any(first):
            self.last_first_clean = self.steps
        return first

    def _move_furniture(self) -> None:
        """This step's moves in list order; a cell that a piece has stood on is dirty again."""
        for step, piece, direction in self.moves:
            if step != self.steps:
                continue
            layout = shift_piece(self.free, self.furniture, piece, direction, self.positions)
            if layout is not None:
                self.free, self.furniture = layout
                self.cleaned &= free_places(self.free)
                self._close_spills()  # also where the piece will have gone on after its next move

    def _close_spills(self) -> None:
        """Nothing is spilt any more where a robot stands, or a piece of furniture does."""
        for place in sorted(self.spilt):
            if place in self.positions or not self.is_free(place):
                self.spilt.remove(place)
                self.spill_delays.append(self.steps - self.spilt_at.pop(place))

    def _spill(self) -> None:
        """Clean cells in a square become dirty; robots near enough know all of these."""
        clean = [p for p in sorted(self.cleaned - self.spilt) if p not in self.positions]
        if self.steps not in self.spills or not clean:
            return
        row, col = clean[self.spills[self.steps] * len(clean) >> 32]
        size = self.settings.spill_size
        top, left = row - (size - 1) // 2, col - (size - 1) // 2
        square = set(product(range(top, top + size), range(left, left + size)))
        hit = square & set(clean)
        self.spilt |= hit
        self.spilt_at |= dict.fromkeys(hit, self.steps)
        most = self.settings.spill_noticed_within
        free = free_places(self.free)
        for robot, position in enumerate(self.positions):
            walks = walking_distances(free, position)
            if most is None or min(walks[place] for place in hit) <= most:
                notice = Record(False, written=self.steps, spilt=True)
                self.map_of(robot).update(dict.fromkeys(hit, notice))

    def spill_delay(self) -> Fraction | None:
        """Mean steps from spill to clean over the cells spilt so far, open ones until now."""
        delays = self.spill_delays + [self.steps - at for at in self.spilt_at.values()]
        return Fraction(sum(delays), len(delays)) if delays else None

    def spill_cleaned(self) -> Fraction | None:
        """The share of the cells spilt so far that are not open."""
        closed, still_open = len(self.spill_delays), len(self.spilt)
        return Fraction(closed, closed + still_open) if closed + still_open else None

    def _touch(self) -> None:
        """With touch4 the four neighbours are known; one known as available stays as it is.

        Unless something is spilt there, which is noticed.
        """
        if self.settings.sensor is not Sensor.TOUCH4:
            return
        for robot, position in enumerate(self.positions):
            known = self.map_of(robot)
            for place in neighbours(position):
                held = known.get(place)
                if not self.is_free(place):
                    known[place] = Record(blocked=True, written=self.steps)
                elif place in self.spilt:
                    known[place] = Record(blocked=False, written=self.steps, spilt=True)
                elif held is None or held.blocked:
                    known[place] = Record(blocked=False, written=self.steps)

    def _note_robots(self) -> None:
        """A private map notes where robots in contact stand, which are clean cells."""
        if not self.settings.robots_noted:
            return
        for robot, line in enumerate(self.contacts()):
            for other, live in enumerate(line):
                if live:
                    seen = Record(blocked=False, written=self.steps, cleaned=self.steps)
                    kept = self.settings.lends or self.settings.patches
                    for maps in (self.maps, self.own_maps) if kept else (self.maps,):
                        maps[robot][self.positions[other]] = seen

    def _merge(self) -> None:
        """Robots in contact unite their maps, from the maps as they were before any union."""
        if self.settings.memory is not Memory.MERGED:
            return
        before = list(self.maps)
        for i, line in enumerate(self.contacts()):
            for j, live in enumerate(line):
                if live:
                    self.maps[i] = union(self.maps[i], before[j])

    def _exchange(self) -> None:
        """Robots in contact tell each other what changed in their maps, the oldest first.

        Never what a robot heard from the very one it tells; all from the maps as they were before.
        """
        most = self.settings.exchange_cells
        if most is None:
            return
        for robot, known in enumerate(self.maps):
            for place, record in known.items():
                if self.said[robot].get(place) != self._content(record):
                    self.said[robot][place] = self._content(record)
                    self.changed[robot][place] = self.steps
                    self.heard_from[robot].pop(place, None)
        a_cell = (
            ((self.rows + 2) * (self.cols + 2) - 1).bit_length() + 2 + self.max_steps.bit_length()
        )
        self.exchanged_bits = [0] * self.n_agents
        told: list[tuple[int, int, Place, Record]] = []
        for hearer, line in enumerate(self.contacts()):
            for sender, live in enumerate(line):
                if not live:
                    continue
                until = self.told_until.get((hearer, sender), (-1, (-1, -1)))
                news = sorted(
                    (step, place)
                    for place, step in self.changed[sender].items()
                    if (step, place) > until and self.heard_from[sender].get(place) != hearer
                )[:most]
                if news:
                    self.told_until[hearer, sender] = news[-1]
                told += [(hearer, sender, p, self.maps[sender][p]) for _, p in news]
                self.exchanged_bits[sender] += most.bit_length() + len(news) * a_cell
        heard: dict[tuple[int, Place], tuple[int, Record]] = {}
        for hearer, sender, place, record in told:  # of equal records the lowest sender's counts
            best = heard.get((hearer, place))
            if best is None or union({place: best[1]}, {place: record}) != {place: best[1]}:
                heard[hearer, place] = sender, record
        for (hearer, place), (sender, record) in heard.items():
            alone = {place: self.maps[hearer][place]} if place in self.maps[hearer] else {}
            if union(alone, {place: record}) != alone:
                self.maps[hearer][place] = record
                if self.said[hearer].get(place) != self._content(record):
                    self.said[hearer][place] = self._content(record)
                    self.changed[hearer][place] = self.steps + 1
                    self.heard_from[hearer][place] = sender

    def _lend(self) -> None:
        """Robots in contact see by the union of their maps until the next step begins."""
        if not self.settings.lends:
            return
        self.own_maps, contacts = self.maps, self.contacts()
        self.maps = [dict(known) for known in self.own_maps]
        a_cell = 2 + self.max_steps.bit_length()
        self.exchanged_bits = [0] * self.n_agents
        for hearer, line in enumerate(contacts):
            for sender, live in enumerate(line):
                if live:
                    self.maps[hearer] = union(self.maps[hearer], self.own_maps[sender])
                    self.exchanged_bits[sender] += (self.rows + 2) * (self.cols + 2) * a_cell

    def _hear(self) -> None:
        """Robots hear what lies around others: of several the cleaned, then the free counts."""
        if self.settings.patches is None:
            return
        robots = range(self.n_agents)
        if self.told is not None:
            patches, edges = self.told(self.steps)
        else:
            patches = [[self._kind(robot, p) for p in self._around(robot)] for robot in robots]
            edges = self.contacts()
            told = {"all": (1, 2, 3), "cleaned": (3,), "blocked": (1,)}[self.settings.patches]
            patches = [[kind if kind in told else 0 for kind in line] for line in patches]
            bits = 98 if len(told) > 1 else 49
            self.exchanged_bits = [sum(line[i] for line in edges) * bits for i in robots]
        around = [self._around(robot) for robot in robots]
        for hearer in robots:
            kinds: dict[Place, int] = {}
            for sender in robots:
                for place, kind in zip(around[sender], patches[sender], strict=True):
                    if edges[hearer][sender] and self.in_matrix(place):
                        kinds[place] = max(kind, kinds.get(place, 0))
            for place, kind in kinds.items():
                if kind > 0:
                    cleaned = self.steps if kind == 3 else None
                    self.heard[hearer][place] = Record(kind == 1, self.steps, cleaned)

    def _around(self, robot: int) -> list[Place]:
        """The 7 x 7 places around a robot, row by row."""
        row, col = self.positions[robot]
        return [(row + down, col + right) for down, right in product(range(-3, 4), repeat=2)]

    def _kind(self, robot: int, place: Place) -> int:
        """0 unknown, 1 blocked, 2 not cleaned, 3 cleaned, by what the robot itself has written."""
        record = self.own_maps[robot].get(place)
        if record is None:
            return 0
        return 1 if record.blocked else 2 if record.cleaned is None else 3

    def _see_by_heard(self) -> None:
        """What a robot heard is seen where its own map is blank, or says that nobody cleaned."""
        if self.settings.patches is None:
            return
        self.own_maps = self.maps
        self.maps = [dict(own) for own in self.own_maps]
        for robot, heard in enumerate(self.heard):
            for place, record in heard.items():
                own = self.own_maps[robot].get(place)
                uncleaned = own is not None and not own.blocked and own.cleaned is None
                later = own is not None and record.written >= own.written
                if own is None or (uncleaned and later and record.cleaned is not None):
                    self.maps[robot][place] = record

    def _content(self, record: Record) -> Any:
        """What a map says of a cell; without decay the step of a cleaning is no part of it."""
        if self.settings.decay_steps is not None:
            return record
        return record.blocked, record.cleaned is not None


# --------------------------------------------------------------------------- nearest_unknown


Orders = Sequence[Sequence[int]]  # for each robot: in which it tries directions


def search(
    world: World, robot: int, orders: Orders = (), closed: Collection[Place] = ()
) -> dict[Place, tuple[int, int | None]]:
    """{place: (steps, first action)} in the order breadth-first search finds them.

    Over cells not known to be blocked, not occupied now and not `closed`; ties in the robot's
    order, which is up, right, down, left if not given.
    """
    known, start = world.map_of(robot), world.positions[robot]
    found: dict[Place, tuple[int, int | None]] = {start: (0, None)}
    queue = deque([start])
    while queue:
        place = queue.popleft()
        steps, first = found[place]
        for action in orders[robot] if orders else range(4):
            reached = neighbour(place, action)
            blocked = reached in closed or (reached in known and known[reached].blocked)
            open_now = world.in_matrix(reached) and not blocked and reached not in world.positions
            if open_now and reached not in found:
                found[reached] = steps + 1, action if first is None else first
                queue.append(reached)
    return found


def targets(world: World, robot: int, orders: Orders = ()) -> list[Place]:
    """The unknown or spilt cells it reaches, or where there are none the dirty; nearest first."""
    known = world.map_of(robot)
    others = [place for place in search(world, robot, orders) if place != world.positions[robot]]
    unknown = [place for place in others if place not in known or known[place].spilt]
    dirty = [p for p in others if value(known.get(p), world.steps, world.settings) == DIRTY]
    return unknown or dirty


def explores(world: World, robot: int, orders: Orders = ()) -> bool:
    """Whether its targets are unknown or spilt cells."""
    known = world.map_of(robot)
    places = targets(world, robot, orders)
    return any(place not in known or known[place].spilt for place in places)


def assigned(world: World, assignment: Assignment, orders: Orders = ()) -> list[Place | None]:
    """Each robot's target; None where nothing was assigned to it.

    Greedy: by ascending (steps, robot, order of discovery), each target to one robot.
    Hungarian: the most robots with distinct targets, then the least sum of steps; ties as they
    fall. A robot needs to look at its n nearest only: n - 1 others cannot take them all.
    Robots that reach an unknown or spilt cell compete among themselves, and so do the others.
    """
    robots = range(world.n_agents)
    found = [search(world, robot, orders) for robot in robots]
    options = [targets(world, robot, orders) for robot in robots]
    tier = [explores(world, robot, orders) for robot in robots]
    taken: list[Place | None] = [None] * world.n_agents
    if assignment is Assignment.NONE:
        return [places[0] if places else None for places in options]
    if assignment is Assignment.GREEDY:
        pairs = [
            (found[robot][place][0], robot, order, place)
            for robot in robots
            for order, place in enumerate(options[robot])
        ]
        for _, robot, _, place in sorted(pairs):
            rivals = [taken[other] for other in robots if tier[other] == tier[robot]]
            if taken[robot] is None and place not in rivals:
                taken[robot] = place
        return taken
    nearest = [[*places[: world.n_agents], None] for places in options]

    def cost(choice: Sequence[Place | None]) -> tuple[int, int]:
        idle = sum(place is None for place in choice)
        return idle, sum(found[i][p][0] for i, p in enumerate(choice) if p is not None)

    def distinct(choice: Sequence[Place | None]) -> bool:
        places = [(tier[i], place) for i, place in enumerate(choice) if place is not None]
        return len(places) == len(set(places))

    choices = (list(choice) for choice in product(*nearest))
    return min(filter(distinct, choices), key=cost)


def assignment_cost(world: World, places: Sequence[Place | None]) -> tuple[int, int]:
    """(robots without a target, sum of the others' steps): what `hungarian` makes least."""
    steps = [search(world, i)[place][0] for i, place in enumerate(places) if place is not None]
    return world.n_agents - len(steps), sum(steps)


def nearest_unknown(
    world: World, assignment: Assignment = Assignment.NONE, orders: Orders = ()
) -> list[int | None]:
    """One action a robot, None where any will do (nothing unknown or dirty is reachable).

    A robot that the assignment left without a target goes to its own nearest.
    """
    actions: list[int | None] = []
    for robot, place in enumerate(assigned(world, assignment, orders)):
        own = targets(world, robot, orders)
        goal = place if place is not None else (own[0] if own else None)
        actions.append(None if goal is None else search(world, robot, orders)[goal][1])
    return actions


# --------------------------------------------------------------------------- measures

PER_CENTS = (90, 95, 99, 100)


@dataclass
class Episode:
    """A recorded play: lists by state hold steps 0..T, lists by step hold T entries."""

    max_steps: int
    bounds: dict[str, int | None]
    coverage: list[tuple[int, int]] = field(default_factory=list)  # by state
    positions: list[list[Place]] = field(default_factory=list)  # by state
    certified: list[bool] = field(default_factory=list)  # by state
    spills: list[dict[str, Fraction | None]] = field(default_factory=list)  # by state, if any
    outcomes: list[Outcome] = field(default_factory=list)  # by step
    edges: list[int] = field(default_factory=list)  # by step, as the actions were chosen


def play(world: World, joint_actions: Iterable[Sequence[int]], certify: bool = False) -> Episode:
    """Plays a fresh world to its end or the actions'; `certify` goes on past T_100."""
    episode = Episode(world.max_steps, bounds(world))

    def note() -> None:
        episode.coverage.append(world.coverage())
        episode.positions.append(list(world.positions))
        episode.certified.append(world.certified())
        if world.settings.spills:
            delay, cleaned = world.spill_delay(), world.spill_cleaned()
            episode.spills.append({"spill_delay": delay, "spill_cleaned": cleaned})

    note()
    for actions in joint_actions:
        episode.edges.append(sum(map(sum, world.contacts())) // 2)
        outcome = world.step(actions)
        episode.outcomes.append(outcome)
        note()
        finished = outcome.terminated and (world.certified() or not certify)
        if finished or outcome.truncated or world.steps >= world.max_steps:
            break
    return episode


def need(per_cent: int, free_cells: int) -> int:
    """ceil(q F / 100), on integers."""
    return -(-per_cent * free_cells // 100)


def bounds(world: World) -> dict[str, int | None]:
    """No play of a fresh world is quicker than these; null where furniture will move."""
    names = [f"bound_{q}" for q in PER_CENTS] + ["bound_certify"]
    if world.moves:
        return dict.fromkeys(names)
    free, n, n0 = free_places(world.free), world.n_agents, len(set(world.positions))
    found: dict[str, int | None] = {
        f"bound_{q}": max(0, math.ceil(Fraction(need(q, len(free)) - n0, n))) for q in PER_CENTS
    }
    walks = [walking_distances(free, start) for start in world.positions]
    farthest = max(min(walk[place] for walk in walks) for place in free)
    found["bound_100"] = max(math.ceil(Fraction(len(free) - n0, n)), farthest)
    walls = {near for place in free for near in neighbours(place)} - free
    knowledge = {world.settings.knowledge_of(robot) for robot in range(n)}
    blind = world.settings.sensor is Sensor.BUMP and knowledge == {Knowledge.UNKNOWN}
    found["bound_certify"] = math.ceil(Fraction(len(free) - n0 + len(walls), n)) if blind else None
    return found


def ratio(steps: int | None, bound: int | None) -> Fraction | None:
    """Steps as a multiple of the bound; null for a bound of 0."""
    return Fraction(steps, bound) if steps is not None and bound else None


def measures(episode: Episode) -> dict[str, Any]:
    """Every measure of one house, None where null; all but T_certify stop at T_100 or the end."""

    def first(states: Iterable[bool]) -> int | None:
        return next((step for step, holds in enumerate(states) if holds), None)

    reached = {
        f"T_{q}": first(cleaned >= need(q, free) for cleaned, free in episode.coverage)
        for q in PER_CENTS
    }
    finished = reached["T_100"]
    end = len(episode.outcomes) if finished is None else finished
    outcomes, positions = episode.outcomes[:end], episode.positions[: end + 1]
    shares = [Fraction(*counts) for counts in episode.coverage[: end + 1]]
    held = episode.max_steps + 1 - len(shares)  # 1 after T_100, else as the episode left it

    n_agents = len(positions[0])
    cells = [{places[robot] for places in positions} for robot in range(n_agents)]
    distinct = len(set().union(*cells))
    entries = n_agents + sum(sum(outcome.moved) for outcome in outcomes)
    cleaned = [1 + sum(outcome.newly_cleaned[i] for outcome in outcomes) for i in range(n_agents)]
    mean = Fraction(sum(cleaned), n_agents)
    variance = sum((count - mean) ** 2 for count in cleaned) / n_agents
    return {
        **reached,
        **episode.bounds,
        "T_certify": first(episode.certified),
        "coverage": shares[-1],
        "coverage_auc": (sum(shares) + held * shares[-1]) / (episode.max_steps + 1),
        "return": sum((sum(outcome.own_reward) for outcome in outcomes), Fraction(0)),
        "redundancy": Fraction(entries, distinct) - 1,
        "overlap": Fraction(sum(map(len, cells)), distinct) - 1,
        "balance": math.sqrt(variance) / mean,
        "bumps": sum(sum(outcome.bumped) for outcome in outcomes),
        "collisions": sum(sum(outcome.collided) for outcome in outcomes),
        **(episode.spills[end] if episode.spills else {}),
        "contact": Fraction(sum(map(bool, episode.edges[:end])), end) if end else None,
        "edges": Fraction(sum(episode.edges[:end]), end) if end else None,
    }
