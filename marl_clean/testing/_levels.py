"""Levels for the contracts: by the name of their yaml, or by their class and its settings."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from omegaconf import OmegaConf

from marl_clean.config import schema
from marl_clean.config.compose import SEVERAL, compose_config
from marl_clean.config.config_hash import container
from marl_clean.errors import BadInput

Level = str | type
"""A level's name, as on the command line, or its class."""


@dataclass(frozen=True)
class Maker:
    """Makes a level again and again, with what its room hands over in code.

    Attributes:
        label: what the level is called in messages, such as `comm=plan`.
        build: from keyword arguments to a new object.
        takes: whether the constructor has a parameter of this name.
        constant: what the class sets a name to, None where it says nothing.
    """

    label: str
    build: Callable[..., Any]
    takes: Callable[[str], bool]
    constant: Callable[[str], Any]

    def __call__(self, **parts: Any) -> Any:
        """Return a new object; parts that the constructor does not ask for are left out."""
        return self.build(**{name: part for name, part in parts.items() if self.takes(name)})


def maker(room: str, level: Level, settings: Mapping[str, Any]) -> Maker:
    """Return how a level is made: its yaml's values, or none of a class, and `settings` on top.

    Raises:
        BadInput: no such level, or a setting that it does not take.
    """
    if isinstance(level, type):
        return _of_class(room, level, dict(settings))
    composed = compose_config([f"{room}=[{level}]" if room in SEVERAL else f"{room}={level}"])
    section = composed[room][level] if room in SEVERAL else composed[room]
    changed = OmegaConf.create({**section, **settings})
    key = f"{room}.{level}" if room in SEVERAL else room
    for problem in schema.problems_of_level(container(changed), key, room):
        raise BadInput(f"{problem.key}: {problem.reason}")
    target = str(section["_target_"])
    return Maker(
        label=_label(room, level, settings),
        build=lambda **parts: schema.instantiate(changed, **parts),
        takes=lambda name: schema.takes(target, name),
        constant=lambda name: schema.constant(target, name),
    )


def _of_class(room: str, level: type, settings: dict[str, Any]) -> Maker:
    parameters = inspect.signature(level).parameters
    return Maker(
        label=_label(room, level.__name__, settings),
        build=lambda **parts: level(**{**settings, **parts}),
        takes=lambda name: name in parameters,
        constant=lambda name: getattr(level, name, None),
    )


def _label(room: str, level: str, settings: Mapping[str, Any]) -> str:
    changes = (f"{room}.{key}={value}" for key, value in settings.items())
    return " ".join([f"{room}={level}", *changes])
