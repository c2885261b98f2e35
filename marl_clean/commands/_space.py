"""What `marl-clean tune` searches: keys and their spaces, in Hydra's grammar of sweeps.

`a,b` and `choice(a,b)` are choices, of levels too; `range(1,8)` is the numbers that a sweep would
take, 1 to 7; `interval(0.1,0.9)` is every number between its ends, whole numbers where the key
takes no others; `tag(log, ...)` draws evenly on the scale of logarithms.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

from omegaconf import DictConfig

from marl_clean.config.config_hash import OUTSIDE_THE_HASH, config_hash
from marl_clean.config.hydra_adapter import Override
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.stored import parsed_for_training
from marl_clean.errors import BadInput

LOG = "log"
MOST_CHOICES = 1000
WITHOUT_RESULT = tuple(key for key in OUTSIDE_THE_HASH if key != "checkpoint")


@dataclass(frozen=True)
class Dimension:
    """One searched key.

    Attributes:
        texts: the values of a choice or a range, each as typed; none of an interval.
        low, high: the ends of numbers, both included; None for a choice.
        step: between the numbers of a range; None for an interval.
        whole: whether the numbers are integers.
        log: whether they are drawn evenly on the scale of logarithms.
    """

    key: str
    texts: tuple[str, ...] = ()
    low: int | float | None = None
    high: int | float | None = None
    step: int | float | None = None
    whole: bool = False
    log: bool = False

    @property
    def ends(self) -> tuple[str, ...]:
        """The values that must fit the key: all of a choice, the ends of numbers."""
        if self.low is None or self.high is None:
            return self.texts
        return self.text_of(self.low), self.text_of(self.high)

    def text_of(self, number: int | float) -> str:
        """A number of this space as typed on the command line."""
        if self.texts:  # Optuna adds up steps, which is not exact
            return min(self.texts, key=lambda text: abs(float(text) - number))
        return str(int(number)) if self.whole else repr(float(number))

    def __str__(self) -> str:
        if self.low is None:
            return f"choice({','.join(self.texts)})"
        steps = "" if self.step is None else f" in steps of {self.step:g}"
        whole = "whole numbers " if self.whole else ""
        return f"{whole}{self.low!r} to {self.high!r}{steps}{', log' if self.log else ''}"


@dataclass(frozen=True)
class Space:
    """The fixed settings of a search, in their order, and its searched keys among them."""

    settings: tuple[Override, ...]
    dimensions: tuple[Dimension, ...]

    def overrides(self, values: Mapping[str, str], **more: object) -> list[Override]:
        """The settings with these values of the searched keys, and `more` on top."""
        texts = {key: f"{key}={value}" for key, value in values.items()}
        chosen = [texts.get(override.key, override.setting) for override in self.settings]
        keys = more.keys()
        kept = [text for text in chosen if text.partition("=")[0] not in keys]
        return parse_overrides([*kept, *(f"{key}={value}" for key, value in more.items())])

    def config(self, values: Mapping[str, str], **more: object) -> DictConfig:
        """The checked config of a run, under the name that it has in a sweep, too."""
        overrides = self.overrides(values, **more)
        config = parsed_for_training(overrides)
        if any(override.key == "name" for override in overrides):
            config.name = f"{config.name}/{config_hash(config)[:8]}"
        return config

    def first(self) -> dict[str, str]:
        """The first value of every searched key."""
        return {dimension.key: dimension.ends[0] for dimension in self.dimensions}


def read_space(texts: Sequence[str]) -> Space:
    """The space in a command's settings, whose ends all fit their keys.

    Raises BadInput where nothing is searched, or a setting or an end is refused.
    """
    settings = {override.key: override for override in parse_overrides(texts)}  # the last counts
    searched = [_dimension(override) for override in settings.values() if override.is_sweep]
    if not searched:
        example = "'agent.lr=tag(log,interval(1e-4,1e-2))'"
        raise BadInput(f"tune: nothing is searched; give a key several values, such as {example}")
    space = Space(tuple(settings.values()), tuple(searched))
    whole = tuple(_of_the_key(dimension, space) for dimension in searched)
    space = replace(space, dimensions=whole)
    for dimension in space.dimensions:
        for end in dimension.ends:
            space.config({**space.first(), dimension.key: end})
    return space


def _dimension(override: Override) -> Dimension:
    """The space of one setting. Raises BadInput where it makes none."""
    key, span, log = override.key, override.span, LOG in override.tags
    if key in WITHOUT_RESULT or key.partition(".")[0] in WITHOUT_RESULT:
        raise BadInput(f"{key}: changes no result, so there is nothing to search; give one value")
    if unknown := [tag for tag in override.tags if tag != LOG]:
        raise BadInput(f"{override.setting}: no such tag {unknown[0]}; valid: {LOG}")
    if span is None:
        if log:
            raise BadInput(f"{override.setting}: {LOG} is for range and interval")
        # In an order of their own: shuffle() must not make another search of the same choices.
        texts = tuple(sorted(set(override.values)))
        if not texts or len(texts) > MOST_CHOICES:
            raise BadInput(f"{override.setting}: {len(texts)} values; valid: 1 to {MOST_CHOICES}")
        return Dimension(key, texts)
    if not (math.isfinite(span.low) and math.isfinite(span.high)):
        raise BadInput(f"{override.setting}: must have two finite ends")
    if span.step is None and span.low >= span.high:
        raise BadInput(f"{override.setting}: must go from low to high")
    if log and span.low <= 0:
        raise BadInput(f"{override.setting}: {LOG} needs ends above 0")
    whole = isinstance(span.low, int) and isinstance(span.high, int)
    if log and span.step is not None and not (whole and span.step == 1):
        raise BadInput(f"{override.setting}: {LOG} takes no steps; use interval")
    if span.step is None:
        return Dimension(key, (), span.low, span.high, None, whole, log)
    low, step = Decimal(str(span.low)), Decimal(str(span.step))
    high = low + step * (len(override.values) - 1)  # span.high is a sum of floats, not exact
    number = int if whole else float
    return Dimension(key, override.values, number(low), number(high), span.step, whole, log)


def _of_the_key(dimension: Dimension, space: Space) -> Dimension:
    """The dimension as its key takes it: of whole numbers where an interval fits in no other way.

    Hydra makes both ends of an interval floats.
    """
    ends = dimension.low, dimension.high
    if dimension.texts or dimension.whole or any(end is None or end % 1 for end in ends):
        return dimension
    others = {d.key: d.ends[0] for d in space.dimensions if d.low is None or d.texts}
    alone = replace(
        space,
        settings=tuple(
            override
            for override in space.settings
            if not override.is_sweep or override.key in (*others, dimension.key)
        ),
    )
    whole = replace(dimension, whole=True)
    for candidate in (dimension, whole):
        try:
            alone.config({**others, dimension.key: candidate.ends[0]})
        except BadInput:
            continue
        return candidate
    return whole
