"""Labels of configs: the settings in which they differ, `comm=tarmac env.memory=private`."""

from collections.abc import Mapping, Sequence
from typing import Any

from marl_clean.config import levels
from marl_clean.config.compose import leaves

Config = Mapping[str, Any]


def labels(configs: Sequence[Config], without: Sequence[str]) -> list[str]:
    """One label per config: the settings in which they differ, those in `without` ignored.

    Configs without any difference are labelled `run`.
    """
    apart = settings_apart(configs, without)
    texts = [" ".join(f"{key}={value}" for key, value in settings.items()) for settings in apart]
    return [text or "run" for text in texts]


def settings_apart(configs: Sequence[Config], without: Sequence[str]) -> list[dict[str, str]]:
    """The settings in which configs differ, of each config by key, those in `without` ignored.

    Where the levels of a room differ, their keys are left out.
    """
    differing: list[dict[str, str]] = [{} for _ in configs]
    for room in dict.fromkeys(key for config in configs for key in config):
        if room in without:
            continue
        sections = [config.get(room) for config in configs]
        levels = [level_of(section) for section in sections]
        if len(set(levels)) > 1:
            for settings, level in zip(differing, levels, strict=True):
                settings[room] = str(level)
            continue
        values_of = [dict(leaves({room: section})) for section in sections]
        for key in dict.fromkeys(key for values in values_of for key in values):
            if len({str(values.get(key)) for values in values_of}) > 1:
                for settings, values in zip(differing, values_of, strict=True):
                    settings[key] = str(values.get(key))
    return differing


def level_of(section: Any) -> str | None:
    """The level of a room's section, or the names of several; None if it is not a room's."""
    if not isinstance(section, Mapping):
        return None
    if "_target_" in section:
        return levels.level_of(str(section["_target_"]))
    names = [str(name) for name, inner in section.items() if level_of(inner) is not None]
    return "+".join(names) or None
