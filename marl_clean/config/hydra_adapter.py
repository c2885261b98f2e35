"""Hydra's reading of settings and composing of a config.

Hydra is imported here and in `hydra_launching` alone: its inner modules move between versions.
"""

import copy
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

from hydra import compose as hydra_compose
from hydra import version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, IntervalSweep, OverrideType, RangeSweep, Sweep
from hydra.core.override_parser.types import Override as Parsed
from hydra.errors import HydraException
from hydra.initialize import get_gh_backup, restore_gh_from_backup
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from marl_clean.config.levels import levels_in
from marl_clean.config.locate import own, packages
from marl_clean.config.presets import STUDY

VERSION_BASE = "1.3"
CONFIG_NAME = "config"
MOST_VALUES = 100_000  # of one key of a sweep


@dataclass(frozen=True)
class Span:
    """Numbers from `low` to `high`: in steps, or all of them where `step` is None."""

    low: int | float
    high: int | float
    step: int | float | None


@dataclass(frozen=True)
class Override:
    """One setting: its key, its value as written, and that value or the values of a sweep."""

    key: str
    text: str
    value: Any  # None for a sweep
    is_sweep: bool
    values: tuple[str, ...]  # of a finite sweep, each as typed on the command line
    of_hydra: bool
    span: Span | None = None  # of `range(...)` and `interval(...)`
    tags: tuple[str, ...] = ()  # of a sweep, as in `tag(log, interval(1, 9))`

    @property
    def setting(self) -> str:
        """KEY=VALUE, as typed on the command line."""
        return f"{self.key}={self.text}"


class Unreadable(Exception):
    """A text that is not a setting in Hydra's grammar."""


class Unoptimised(Exception):
    """Hydra reads functions such as `range(0,1)` only where Python runs its assertions."""


class Endless(Exception):
    """A range whose values cannot be listed: it has no end, no step, or too many of them."""


class NotPlain(Exception):
    """A setting that adds, moves or deletes a key."""


class NotComposed(Exception):
    """Settings make no config; the message is Hydra's, on one line."""


def parse(text: str) -> Override:
    """Read a setting.

    Raises Unreadable, NotPlain, Endless or Unoptimised where it is not KEY=VALUE.
    """
    try:
        [parsed] = OverridesParser.create().parse_overrides([text])
    except HydraException:
        raise Unreadable(text) from None
    except AttributeError:
        if __debug__:
            raise
        raise Unoptimised(text) from None
    if not parsed.key_or_group:
        raise Unreadable(text)
    if parsed.type is not OverrideType.CHANGE or parsed.package is not None:
        raise NotPlain(text)
    is_sweep = parsed.is_sweep_override()
    value = parsed.value()
    return Override(
        key=parsed.key_or_group,
        text=text.partition("=")[2],
        value=None if is_sweep else value,
        is_sweep=is_sweep,
        values=_values_of(parsed) if parsed.is_discrete_sweep() else (),
        of_hydra=parsed.is_hydra_override(),
        span=_span_of(value),
        tags=tuple(sorted(value.tags)) if isinstance(value, Sweep) else (),
    )


def _values_of(parsed: Parsed) -> tuple[str, ...]:
    """The values of a finite sweep. Raises Endless where it is none."""
    glob = parsed.value()
    if isinstance(glob, Glob):
        return tuple(glob.filter(levels_in(parsed.key_or_group)))
    try:
        values = tuple(islice(parsed.sweep_string_iterator(), MOST_VALUES + 1))
    except (HydraException, ValueError, ArithmeticError):
        raise Endless(parsed.input_line) from None
    if len(values) > MOST_VALUES:
        raise Endless(parsed.input_line)
    return values


def _span_of(value: Any) -> Span | None:
    """The ends of a sweep over numbers, the lower first, the last value of a range included."""
    if isinstance(value, IntervalSweep):
        assert value.start is not None and value.end is not None
        return Span(value.start, value.end, None)
    if isinstance(value, RangeSweep):
        numbers = list(islice(value.range(), MOST_VALUES))
        step = abs(value.step)
        return Span(min(numbers), max(numbers), step) if numbers else None
    return None


def compose(overrides: Sequence[Override]) -> DictConfig:
    """The defaults of the packages' yaml files with settings on top. Raises NotComposed.

    What the chosen levels compose to is kept, so that the jobs of a sweep, most of which differ in
    values alone, do not wait for Hydra each. Values are set in a copy of it, as Hydra sets them.
    """
    groups = {path.name for path in own().conf.iterdir()}
    values = [o for o in overrides if not (o.key in groups or o.of_hydra or "/" in o.key)]
    levels = tuple(override.setting for override in overrides if override not in values)
    config = copy.deepcopy(_composed(levels, _state_of_files()))
    try:
        for override in values:
            OmegaConf.update(config, override.key, override.value, merge=True)
    except OmegaConfBaseException:
        return _by_hydra(override.setting for override in overrides)  # which says what is wrong
    return config


@lru_cache(maxsize=64)
def _composed(settings: tuple[str, ...], state_of_files: Hashable) -> DictConfig:
    return _by_hydra(settings)


def _state_of_files() -> Hashable:
    """What changes when a yaml file of a package does."""
    paths = (path for package in packages() for path in sorted(package.conf.rglob("*.yaml")))
    states = ((path, path.stat()) for path in paths)
    return tuple((str(path), state.st_mtime_ns, state.st_size) for path, state in states)


def _by_hydra(settings: Iterable[str]) -> DictConfig:
    with hydra_here():
        try:
            config = hydra_compose(CONFIG_NAME, list(settings))
        except HydraException as error:
            raise NotComposed(first_line(error)) from None
    with open_dict(config):
        config.pop(STUDY, None)
    return config


def first_line(error: Exception) -> str:
    """The first line of an error's message, or its type where it has none."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


@contextmanager
def hydra_here() -> Iterator[Hydra]:
    """Hydra over the packages' config folders, also inside another program or sweep."""
    outer_state = get_gh_backup()
    GlobalHydra.instance().clear()
    try:
        version.setbase(VERSION_BASE)
        ours, *others = packages()
        path = create_config_search_path(str(ours.conf))
        for package in others:
            path.prepend(package.name, str(package.conf), "schema")  # which must stay last
        yield Hydra.create_main_hydra2("marl-clean", path)
    finally:
        restore_gh_from_backup(outer_state)
