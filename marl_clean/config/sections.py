"""What the keys of a config outside of every room may be, and those of a preset's study."""

from typing import Annotated, TypedDict

from pydantic import Field

from marl_clean.settings import (
    Device,
    FolderName,
    HouseSet,
    HouseSide,
    PositiveFloat,
    PositiveInt,
    Probability,
    Seed,
    Sha256,
)


class LaterEvaluation(TypedDict, total=False):
    """Keys of `evaluation` that the configs of earlier runs lack."""

    optimum: bool
    sides: list[HouseSide]
    team_sizes: list[PositiveInt]


class Evaluation(LaterEvaluation):
    """The config's section `evaluation`: how policies are measured."""

    house_set: HouseSet
    houses: Annotated[int, Field(ge=1, le=10_000)]
    plans: list[str]
    epsilon: Probability
    certify: bool


class Root(TypedDict):
    """The config's keys outside of every room."""

    seed: Seed
    train_houses: Annotated[int, Field(ge=1, le=1_000_000)]
    parameter_budget: Annotated[int, Field(ge=1, le=100_000_000)] | None
    device: Device
    name: FolderName | None
    checkpoint: str | None
    weights: Sha256 | None
    out: str | None


class StudyRule(TypedDict, total=False):
    """An acceptance rule of a study: which number of an arm has to lie on which side of a bound.

    Exactly one bound; a difference or ratio is that of means, to `than`.
    """

    arm: str
    than: str
    measure: str
    below: float
    above: float
    difference_below: float
    difference_above: float
    ratio_below: PositiveFloat
    ratio_above: PositiveFloat


class _StudyOptions(TypedDict, total=False):
    question: str | None
    budget: PositiveInt | str | None
    houses: Annotated[int, Field(ge=1, le=10_000)] | None
    baseline: str
    oracle: str | None
    confidence: Annotated[float, Field(ge=0.5, lt=1)]


class Study(_StudyOptions):
    """A preset's section `study`: what will be compared, and which result is accepted as what."""

    arms: dict[str, list[str]]
    seeds: Annotated[list[Seed], Field(min_length=1)]
    measure: str
    rules: dict[str, dict[str, int | float | str]]
