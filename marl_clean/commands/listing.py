"""`marl-clean list`: the rooms and their levels, a line each."""

import ast
from pathlib import Path

from marl_clean.config.class_source import definition
from marl_clean.config.levels import PRESETS, conf_folder, groups, rooms
from marl_clean.config.stored import shipped_runs
from marl_clean.storage.safe_yaml import load_yaml


def lines() -> list[str]:
    """A line a room, and below it a line a level: its name, and what its class claims.

    After the rooms come the presets, and the trained runs that ship.
    """
    folder = conf_folder()
    result = []
    for room, levels in rooms().items():
        width = max(map(len, levels), default=0)
        claims = (claim(folder / room / f"{level}.yaml") for level in levels)
        lines_ = zip(levels, claims, strict=True)
        result += [room, *(f"  {level:{width}}  {text}" for level, text in lines_)]
    for preset in PRESETS:
        result += [f"{preset}=", *(f"  {name}" for name in groups()[preset])]
    return [*result, "checkpoint=", *(f"  {name}" for name in shipped_runs())]


def claim(level: Path) -> str:
    """The first line of the docstring of the class that a level's yaml names, by `ast`."""
    docstring = ast.get_docstring(definition(load_yaml(level)["_target_"])) or ""
    return docstring.partition("\n")[0]
