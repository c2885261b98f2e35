"""The rooms and their levels, as the folders and files of the packages' `conf/` name them."""

import copy
import reprlib
from functools import lru_cache
from pathlib import Path
from typing import Any

from marl_clean.config.locate import NAME, own, package_of, packages
from marl_clean.errors import BadInput
from marl_clean.storage.safe_yaml import load_yaml

EXPERIMENT = "experiment"
BUDGET = "budget"
PRESETS = (EXPERIMENT, BUDGET)  # groups that set keys of several rooms; not rooms themselves
LONGEST_TARGET = 200  # characters of a `_target_` that are quoted
SEVERAL = ("logger", "channel")  # rooms that take several levels at once, by name


def conf_folder() -> Path:
    """The folder of this package's yaml files."""
    return own().conf


def rooms() -> dict[str, list[str]]:
    """The rooms of `conf/` and the levels of each; presets are not rooms."""
    return {room: levels for room, levels in groups().items() if room not in PRESETS}


def groups() -> dict[str, list[str]]:
    """Rooms and presets, and the levels of each: this package's, then those of plugins.

    A file whose name begins with `_` is no level: it holds what several of them share.
    """
    folders = [folder for folder in sorted(conf_folder().iterdir()) if folder.is_dir()]
    return {folder.name: levels_in(folder.name) for folder in folders}


def levels_in(group: str) -> list[str]:
    """The levels of one room, or the presets of one group: this package's come first."""
    return list(
        dict.fromkeys(
            path.stem
            for package in packages()
            for path in sorted((package.conf / group).glob("[!_]*.yaml"))
        )
    )


def level_file(group: str, level: str) -> Path:
    """The yaml file of a level or preset. Raises BadInput where there is none."""
    for package in packages():
        path = package.conf / group / f"{level}.yaml"
        if path.is_file():
            return path
    raise BadInput(f"{group}={level}: no such level")


def read_level(room: str, level: str) -> dict[str, Any]:
    """The keys of a level's yaml, those it shares with other levels of its room included."""
    path = level_file(room, level)
    state = path.stat()
    values = copy.deepcopy(_read(path, state.st_mtime_ns, state.st_size))
    shared = [read_level(room, name) for name in values.pop("defaults", []) if name != "_self_"]
    return {key: value for section in [*shared, values] for key, value in section.items()}


@lru_cache(maxsize=1024)
def _read(path: Path, *state_of_file: int) -> dict[str, Any]:
    """Kept until the file changes: to check a config reads dozens of levels for their classes."""
    return load_yaml(path)


def is_target(room: str, target: str) -> bool:
    """Whether `target` is the class of one of the room's levels."""
    likely = target.split(".")[-2:-1]
    levels = sorted(levels_in(room), key=lambda level: [level] != likely)
    return any(read_level(room, level).get("_target_") == target for level in levels)


def problem_of_target(target: object, room: str) -> str | None:
    """What is wrong with a `_target_` in a room's section; None where it is valid.

    Valid is a class that a yaml file of the room names, ours or a plugin's: a config may come from
    an untrusted source, and nothing else is ever called.
    """
    if isinstance(target, str) and is_target(room, target):
        return None
    given = repr(target) if len(repr(target)) <= LONGEST_TARGET else reprlib.repr(target)
    reason = f"must name the class of a level of {room}, not {given}"
    if not isinstance(target, str) or package_of(target) is not None:
        return reason
    top = target.partition(".")[0]
    if not NAME.fullmatch(top) or len(top) > LONGEST_TARGET:
        return reason
    return f"{reason}; of a plugin that is not in use, install it or name it: --plugin {top}"


def plugin_of(group: str, level: str) -> str | None:
    """The plugin that provides a level or preset; None for this package's own."""
    for package in packages()[1:]:
        if (package.conf / group / f"{level}.yaml").is_file():
            return package.name
    return None


def level_of(target: str) -> str:
    """The level of a `_target_`: by its module in this package, by its yaml in a plugin."""
    package = package_of(target)
    if package is None or package == own():
        return target.split(".")[2]
    for room, levels in rooms().items():
        for level in levels:
            provided = plugin_of(room, level) == package.name
            if provided and read_level(room, level).get("_target_") == target:
                return level
    raise BadInput(f"{target!r} is no level of the plugin {package.name}")
