"""`marl-clean list`: the rooms and their levels, a line each."""

import ast

from marl_clean.config.class_source import definition
from marl_clean.config.levels import PRESETS, groups, plugin_of, read_level, rooms
from marl_clean.config.stored import shipped_runs


def lines() -> list[str]:
    """One line per room, below it one line per level: its name, and what its class claims.

    A plugin's level has the plugin's name after it. After the rooms come the presets, and the
    trained runs that ship.
    """
    result = []
    for room, levels in rooms().items():
        width = max(map(len, levels), default=0)
        result.append(room)
        for level in levels:
            text = claim(read_level(room, level)["_target_"])
            result.append(f"  {level:{width}}  {text}{_plugin_mark(room, level)}")
    for preset in PRESETS:
        result.append(f"{preset}=")
        result += [f"  {name}{_plugin_mark(preset, name)}" for name in groups()[preset]]
    return [*result, "checkpoint=", *(f"  {name}" for name in shipped_runs())]


def claim(target: str) -> str:
    """The first line of the docstring of the class `target`, by `ast`."""
    docstring = ast.get_docstring(definition(target)) or ""
    return docstring.partition("\n")[0]


def _plugin_mark(group: str, level: str) -> str:
    plugin = plugin_of(group, level)
    return f" ({plugin})" if plugin else ""
