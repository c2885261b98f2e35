"""The rooms and their levels, as the folders and files of the packages' `conf/` name them."""

from pathlib import Path
from typing import Any

from marl_clean.config.locate import own, packages
from marl_clean.errors import BadInput
from marl_clean.storage.safe_yaml import load_yaml

EXPERIMENT = "experiment"
BUDGET = "budget"
PRESETS = (EXPERIMENT, BUDGET)  # groups that set keys of several rooms, and are none themselves
SEVERAL = ("logger", "channel")  # rooms of which several levels may be taken at once, by name


def conf_folder() -> Path:
    """The folder of this package's yaml files."""
    return own().conf


def rooms() -> dict[str, list[str]]:
    """The rooms of `conf/` and the levels of each; presets are not rooms."""
    return {room: levels for room, levels in groups().items() if room not in PRESETS}


def groups() -> dict[str, list[str]]:
    """Rooms and presets, and the levels of each: this package's and then those of others.

    A file whose name begins with `_` is no level: it holds what several of them share.
    """
    folders = [folder for folder in sorted(conf_folder().iterdir()) if folder.is_dir()]
    return {
        folder.name: list(
            dict.fromkeys(
                path.stem
                for package in packages()
                for path in sorted((package.conf / folder.name).glob("[!_]*.yaml"))
            )
        )
        for folder in folders
    }


def level_file(group: str, level: str) -> Path:
    """The yaml file of a level or preset. Raises BadInput where there is none."""
    for package in packages():
        path = package.conf / group / f"{level}.yaml"
        if path.is_file():
            return path
    raise BadInput(f"{group}={level}: no such level")


def read_level(room: str, level: str) -> dict[str, Any]:
    """What the yaml of a level says, with what it shares with others of its room."""
    return _with_shared(level_file(room, level))


def is_target(room: str, target: str) -> bool:
    """Whether `target` is the class of one of the room's levels."""
    likely = target.split(".")[-2:-1]
    levels = sorted(rooms()[room], key=lambda level: [level] != likely)
    return any(read_level(room, level).get("_target_") == target for level in levels)


def _with_shared(path: Path) -> dict[str, Any]:
    values = load_yaml(path)
    shared = [_with_shared(path.with_name(f"{name}.yaml")) for name in values.pop("defaults", [])]
    return {key: value for section in [*shared, values] for key, value in section.items()}
