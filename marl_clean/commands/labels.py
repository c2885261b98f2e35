"""What sets configs apart, in the words of their settings: `comm=tarmac env.memory=private`."""

from collections.abc import Mapping, Sequence
from typing import Any

from marl_clean.config import levels

Config = Mapping[str, Any]


def labels(configs: Sequence[Config], without: Sequence[str]) -> list[str]:
    """One label a config: the settings in which not all of them agree; keys in `without` aside.

    A level says it all: where schemes differ, their keys are not told. Configs that agree in
    everything are called `run`.
    """
    told: list[dict[str, str]] = [{} for _ in configs]
    for room in dict.fromkeys(key for config in configs for key in config):
        if room in without:
            continue
        sections = [config.get(room) for config in configs]
        levels = [level_of(section) for section in sections]
        if len(set(levels)) > 1:
            for label, level in zip(told, levels, strict=True):
                label[room] = str(level)
            continue
        leaves = [dict(leaves_of(section, room)) for section in sections]
        for key in dict.fromkeys(key for one in leaves for key in one):
            if len({str(one.get(key)) for one in leaves}) > 1:
                for label, one in zip(told, leaves, strict=True):
                    label[key] = str(one.get(key))
    return [" ".join(f"{key}={value}" for key, value in one.items()) or "run" for one in told]


def level_of(section: Any) -> str | None:
    """The level that a room's section is, of several their names; None of what is no room."""
    if not isinstance(section, Mapping):
        return None
    if "_target_" in section:
        return levels.level_of(str(section["_target_"]))
    names = [str(name) for name, inner in section.items() if level_of(inner) is not None]
    return "+".join(names) or None


def leaves_of(section: Any, key: str) -> list[tuple[str, Any]]:
    """Every value in a section under its dotted key."""
    if not isinstance(section, Mapping):
        return [(key, section)]
    return [leaf for name, inner in section.items() for leaf in leaves_of(inner, f"{key}.{name}")]
