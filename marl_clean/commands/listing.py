"""`marl-clean list`: the rooms and their levels, a line each."""

import ast

from marl_clean.config.class_source import definition
from marl_clean.config.levels import PRESETS, groups, plugin_of, read_level, rooms
from marl_clean.config.stored import shipped_runs


def lines() -> list[str]:
    """A line a room, and below it a line a level: its name, and what its class claims.

    A level that a plugin brings has the plugin's name after it. After the rooms come the presets,
    and the trained runs that ship.
    """
    result = []
    for room, levels in rooms().items():
        width = max(map(len, levels), default=0)
        targets = ((level, read_level(room, level)["_target_"]) for level in levels)
        claims = (claim(target) + _whose(room, level) for level, target in targets)
        lines_ = zip(levels, claims, strict=True)
        result += [room, *(f"  {level:{width}}  {text}" for level, text in lines_)]
    for preset in PRESETS:
        names = (f"  {name}{_whose(preset, name)}" for name in groups()[preset])
        result += [f"{preset}=", *names]
    return [*result, "checkpoint=", *(f"  {name}" for name in shipped_runs())]


def claim(target: str) -> str:
    """The first line of the docstring of the class `target`, by `ast`."""
    docstring = ast.get_docstring(definition(target)) or ""
    return docstring.partition("\n")[0]


def _whose(group: str, level: str) -> str:
    plugin = plugin_of(group, level)
    return f" ({plugin})" if plugin else ""
