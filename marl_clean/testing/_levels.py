"""Levels for the contracts: by the name of their yaml, or by their class and its settings."""

import importlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from omegaconf import DictConfig, OmegaConf

from marl_clean.config import schema
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import container
from marl_clean.config.levels import SEVERAL, read_level, rooms
from marl_clean.errors import BadInput

Level = str | type
"""A level's name, as on the command line, or its class."""


@dataclass(frozen=True)
class Maker:
    """Builds any number of objects of a level, with the parts that its room passes in code.

    Attributes:
        label: the level's name in messages, such as `comm=plan`.
        level: its class.
        build: from keyword arguments to a new object.
    """

    label: str
    level: type
    build: Callable[..., Any]

    def __call__(self, **parts: Any) -> Any:
        """Return a new object; parts that the constructor has no parameter for are left out."""
        return self.build(**{name: part for name, part in parts.items() if self.takes(name)})

    def takes(self, name: str) -> bool:
        """Whether the constructor has a parameter of this name."""
        return name in _parameters(self.level)

    def constant(self, name: str) -> Any:
        """Return the value that the class gives a name, None where it has none."""
        return getattr(self.level, name, None)


def maker(room: str, level: Level, settings: Mapping[str, Any]) -> Maker:
    """Return the maker of a level: its yaml's values (none for a class), and `settings` on top.

    A plugin's level has a name where the plugin is installed or named by `use_plugins`.

    Raises:
        BadInput: no such level, or a setting that it does not take.
    """
    name = level.__name__ if isinstance(level, type) else level
    changes = (f"{room}.{key}={value}" for key, value in settings.items())
    label = " ".join([f"{room}={name}", *changes])
    if isinstance(level, type):
        return Maker(label, level, lambda **parts: level(**{**settings, **parts}))
    section = level_section(room, level)
    changed = OmegaConf.create({**container(section), **settings})
    key = f"{room}.{level}" if room in SEVERAL else room
    for problem in schema.problems_of_level(container(changed), key, room):
        raise BadInput(f"{problem.key}: {problem.reason}")
    module, _, class_name = str(section["_target_"]).rpartition(".")
    level_class = getattr(importlib.import_module(module), class_name)
    return Maker(label, level_class, lambda **parts: schema.instantiate(changed, **parts))


@cache
def level_section(room: str, level: str) -> DictConfig:
    """Return a level's values by its yaml; cached, since composing takes longer than a clause.

    Only what refers to other rooms needs composing at all.
    """
    if level in rooms()[room]:
        values = read_level(room, level)
        if "${" not in str(values):
            return OmegaConf.create(values)
    composed = compose_config([f"{room}=[{level}]" if room in SEVERAL else f"{room}={level}"])
    return composed[room][level] if room in SEVERAL else composed[room]


def _parameters(level: type) -> set[str]:
    """The names of a constructor's parameters, those passed on to its bases by **kwargs too."""
    names: set[str] = set()
    for base in level.__mro__:
        if "__init__" in vars(base):
            parameters = inspect.signature(vars(base)["__init__"]).parameters.values()
            names |= {parameter.name for parameter in parameters}
            if all(parameter.kind is not parameter.VAR_KEYWORD for parameter in parameters):
                break
    return names - {"self"}
