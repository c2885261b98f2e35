"""Fixed choices and value ranges that constructors and the config schema share.

No torch here: the commands check a config against these types before torch is imported.
"""

import re
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field


class Memory(StrEnum):
    """Whose map a robot reads and writes (paper §3.2)."""

    SHARED = "shared"
    PRIVATE = "private"
    MERGED = "merged"


class Knowledge(StrEnum):
    """What the map holds when an episode starts (paper §3.4)."""

    UNKNOWN = "unknown"
    MEMORISED = "memorised"
    STALE = "stale"


KnowledgeOfTeam = Knowledge | list[Knowledge]  # one for all robots, or an entry for each


class Starts(StrEnum):
    """Where robots start that the house gives no place: anywhere, or next to each other."""

    ANYWHERE = "anywhere"
    TOGETHER = "together"


class Sensor(StrEnum):
    """How robots detect walls: by bumping, or by touching the four neighbours."""

    BUMP = "bump"
    TOUCH4 = "touch4"


class Decay(StrEnum):
    """The paper's two readings of how a cleaned cell ages, over C = `decay_steps` (§3.2)."""

    FORMULA = "formula"  # falls by 1/C a step: dirty after C/2 steps
    SENTENCE = "sentence"  # falls by 0.5/C a step: dirty after C steps


class Cases(StrEnum):
    """How the rows of the reward combine (§3.3)."""

    ADD = "add"
    EXCLUDE = "exclude"


class ObstaclePay(StrEnum):
    """When a bump pays: the paper's text, or its formula (§3.3)."""

    FIRST = "first"
    EVERY = "every"


class PaidBy(StrEnum):
    """By what a cell's cleaning and discovery are valued: a robot's own map, or all maps united."""

    OWN_MAP = "own_map"
    TEAM_MAP = "team_map"


class Assignment(StrEnum):
    """How targets are assigned to robots."""

    NONE = "none"
    GREEDY = "greedy"
    HUNGARIAN = "hungarian"


class Ties(StrEnum):
    """The order in which a search tries the four directions: it decides between equal paths."""

    FIXED = "fixed"  # up, right, down, left
    STRAIGHT = "straight"  # the direction of the robot's last move, then the fixed order
    ROTATED = "rotated"  # robot i starts the fixed order at direction i mod 4


class Form(Enum):
    """The form of what a robot sees: what an observation gives and an encoder takes."""

    SQUARES = "squares"
    VECTOR = "a vector"


class HouseOrder(StrEnum):
    """Which house an episode gets: a drawn one, or environment i always house i."""

    RANDOM = "random"
    FIXED = "fixed"


class HouseSet(StrEnum):
    """Held-out houses: to choose weights by, or to measure the chosen ones once."""

    VALIDATION = "validation"
    TEST = "test"


def _odd(value: int) -> int:
    if value % 2 == 0:
        near = f"{value - 1} and {value + 1} are"
        raise ValueError(f"must be odd, the robot stands in the middle; {value} is not, {near}")
    return value


def _ascending(value: list[int]) -> list[int]:
    if value[0] > value[1]:
        raise ValueError(f"must go from low to high, not from {value[0]} to {value[1]}")
    return value


def _two_numbers(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(f"must be a range, not {value}; give [{value}, {value}] or two numbers")
    return value


def _pays_as(value: float) -> float:
    if value not in (-0.2, 0):
        raise ValueError(f"must be -0.2 or 0, not {value}")
    return value


PositiveInt = Annotated[int, Field(ge=1, lt=2**31)]
NonNegativeInt = Annotated[int, Field(ge=0, lt=2**31)]
Worlds = Annotated[int, Field(ge=1, le=1_000_000)]
LayerWidth = Annotated[int, Field(ge=1, le=16_384)]  # of a layer: two such are 1 GiB of weights
Layers = Annotated[list[LayerWidth], Field(min_length=1, max_length=32)]
BufferFrames = Annotated[int, Field(ge=1, le=100_000_000)]
RadiusCells = Annotated[float, Field(gt=0, le=64)]
Precision = Literal["float32", "bfloat16"]
Recurrence = Literal["none", "gru"]
RisesWith = Literal["progress", "successes"]
Play = Literal["argmax", "sampled"]
Tells = Literal["all", "cleaned", "blocked"]
StatesOf = Literal["planner", "learner"]
Norm = Literal["none", "layer"]
PositiveShare = Annotated[float, Field(gt=0, le=1)]
BitsPerNumber = Annotated[int, Field(ge=1, le=16)]
OddInt = Annotated[int, Field(ge=1), AfterValidator(_odd)]
OddFromThree = Annotated[int, Field(ge=3), AfterValidator(_odd)]
PositiveFloat = Annotated[float, Field(gt=0, allow_inf_nan=False)]
FiniteFloat = Annotated[float, Field(allow_inf_nan=False)]
NonNegativeFloat = Annotated[float, Field(ge=0, allow_inf_nan=False)]
NonPositiveFloat = Annotated[float, Field(le=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1)]
UncleanedAtMost = Annotated[float, Field(ge=0, lt=0.5)]  # a cleaned cell is shown as 0.5 at most
WallPays = Annotated[float, Field(ge=0, le=2)]  # at most what an unknown free cell pays
SpillsPerEpisode = Annotated[int, Field(ge=0, le=1000)]
SpillSize = Annotated[int, Field(ge=1, le=64)]
UnknownPaysAs = Annotated[float, AfterValidator(_pays_as)]
Scales = Annotated[int, Field(ge=2, le=4)]
RangeCells = Annotated[int, Field(ge=1, le=1024)]
LONGEST_NAME = 200  # of a run; file systems take 255 bytes a folder
LARGEST_SIDE = 4096  # rows or columns of a house in cells, or of its image in pixels
HouseSide = Annotated[int, Field(ge=1, le=LARGEST_SIDE)]
_Number = TypeVar("_Number", bound=int)
_LowAndHigh = Annotated[
    list[_Number],
    Field(min_length=2, max_length=2),
    AfterValidator(_ascending),
    BeforeValidator(_two_numbers),
]
Range = _LowAndHigh[HouseSide]
Ranges = Annotated[list[Range], Field(min_length=1)]
Margins = Annotated[
    list[_LowAndHigh[Annotated[int, Field(ge=0, le=LARGEST_SIDE)]]], Field(min_length=1)
]
Kinds = Annotated[list[Literal["rooms", "single_room", "cluttered", "open"]], Field(min_length=1)]


def _colours(value: list[list[int]]) -> list[list[int]]:
    if not value or any(len(c) != 3 or not 0 <= min(c) <= max(c) <= 255 for c in value):
        raise ValueError(
            f"must be colours [red, green, blue] of 0 to 255, as in [[32,115,185]], not {value}"
        )
    return value


Colours = Annotated[list[list[int]], AfterValidator(_colours)]


def _folder_name(value: str) -> str:
    if len(value) > LONGEST_NAME:
        raise ValueError(f"must be at most {LONGEST_NAME} characters, not {len(value)}")
    if not re.fullmatch(r"[\w+=,@-][\w.+=,@-]*(/[\w+=,@-][\w.+=,@-]*)*", value):
        raise ValueError(f"must be a folder's name of letters, digits and _.+=,@- , not {value!r}")
    return value


def _device(value: str) -> str:
    if not re.fullmatch(r"cpu|mps|cuda(:\d+)?", value):
        raise ValueError(f"must be cpu, cuda, cuda:1 or mps, not {value!r}")
    return value


def _task(value: str) -> str:
    if not re.fullmatch(r"(mpe2|pettingzoo\.[a-z]+)\.[a-z][a-z0-9_]*_v[0-9]+", value):
        valid = "mpe2.simple_spread_v3 or pettingzoo.sisl.pursuit_v5"
        raise ValueError(f"must name a task of mpe2 or pettingzoo, such as {valid}, not {value!r}")
    return value


def _sha256(value: str) -> str:
    if not re.fullmatch(r"[0-9a-f]{64}", value):
        raise ValueError(f"must be a sha256 of 64 hex digits, not {value!r}")
    return value


Task = Annotated[str, AfterValidator(_task)]  # nothing else is imported: configs may be untrusted
Options = dict[str, int | float | bool]
Sha256 = Annotated[str, AfterValidator(_sha256)]
FolderName = Annotated[str, AfterValidator(_folder_name)]
Device = Annotated[str, AfterValidator(_device)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]


@dataclass(frozen=True)
class Spills:
    """The config's section `env.spills`: patches of clean cells that become dirty again.

    Attributes:
        per_episode: how many spills are drawn for an episode.
        noticed_within: steps on foot from the patch within which a robot notices a spill; None:
            all robots notice it, however far away; 0: none does.
        size: the side in cells of the square that a spill covers.
        pays: what cleaning a spilt cell pays, in place of the cleaning term.
    """

    per_episode: SpillsPerEpisode = 0
    noticed_within: NonNegativeInt | None = None
    size: SpillSize = 2
    pays: NonNegativeFloat = 2.0


@dataclass(frozen=True)
class Collectors:
    """The config's section `trainer.collectors`: where frames are collected, in how many parts."""

    backend: Literal["none", "process", "ray"] = "none"
    num: PositiveInt = 1


@dataclass(frozen=True)
class Ground:
    """Weights of losses that ground messages, and whether messages learn from these alone."""

    sender_map: NonNegativeFloat = 0.0
    missing: NonNegativeFloat = 0.0
    only: bool = False
