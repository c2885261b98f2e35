"""Fixed choices and value ranges that constructors and the config schema share.

No torch here: the commands check a config against these types before torch is imported.
"""

from enum import Enum
from typing import Annotated

from pydantic import AfterValidator, Field


class Memory(str, Enum):
    """Whose map a robot reads and writes (paper §3.2)."""

    SHARED = "shared"
    PRIVATE = "private"
    MERGED = "merged"


class Knowledge(str, Enum):
    """What the map holds when an episode starts (paper §3.4)."""

    UNKNOWN = "unknown"
    MEMORISED = "memorised"
    STALE = "stale"


class Sensor(str, Enum):
    """How robots learn of walls: by bumping, or by touching the four neighbours."""

    BUMP = "bump"
    TOUCH4 = "touch4"


class Decay(str, Enum):
    """The paper's two readings of how a cleaned cell ages, over C = `decay_steps` (§3.2)."""

    FORMULA = "formula"  # falls by 1/C a step: dirty after C/2 steps
    SENTENCE = "sentence"  # falls by 0.5/C a step: dirty after C steps


class Cases(str, Enum):
    """How the rows of the reward combine (§3.3)."""

    ADD = "add"
    EXCLUDE = "exclude"


class ObstaclePay(str, Enum):
    """When a bump pays: the paper's text, or its formula (§3.3)."""

    FIRST = "first"
    EVERY = "every"


class Assignment(str, Enum):
    """Who decides which robot takes which target."""

    NONE = "none"
    GREEDY = "greedy"
    HUNGARIAN = "hungarian"


class HouseOrder(str, Enum):
    """Which house an episode gets: a drawn one, or environment i always house i."""

    RANDOM = "random"
    FIXED = "fixed"


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError(f"must be odd, the robot stands in the middle; {value - 1} and {value + 1} are")
    return value


def _ascending(value: list[int]) -> list[int]:
    if value[0] > value[1]:
        raise ValueError(f"must go from low to high, not from {value[0]} to {value[1]}")
    return value


PositiveInt = Annotated[int, Field(ge=1)]
NonNegativeInt = Annotated[int, Field(ge=0)]
OddInt = Annotated[int, Field(ge=1), AfterValidator(_odd)]
PositiveFloat = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegativeFloat = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1)]
Range = Annotated[
    list[PositiveInt], Field(min_length=2, max_length=2), AfterValidator(_ascending)
]
