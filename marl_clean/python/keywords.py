"""Keyword settings of Python calls as the overrides that commands take; no torch.

comm="tarmac", n_agents=3, house="apartment"
comm=tarmac env.n_agents=3 house=floorplan house.path=apartment
"""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from marl_clean.commands.shorthand import with_floor_plans
from marl_clean.config.compose import dotted_keys, leaves, unchecked
from marl_clean.config.levels import EXPERIMENT, SEVERAL, groups
from marl_clean.config.locate import use_plugins
from marl_clean.config.stored import find_run, load_config
from marl_clean.errors import BadInput

Settings = str | Sequence[str] | None
"""A preset by its name, or overrides as on the command line; None: the defaults."""

CHECKPOINT, PLUGINS = "checkpoint", "plugins"
BARE = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
RESERVED = ("null", "true", "false", "nan", "inf")  # words that a setting does not read as strings
NEAREST = 3


def overrides_of(settings: Settings, keywords: Mapping[str, Any]) -> list[str]:
    """The overrides of a Python call: `settings`, then `keywords`.

    A keyword is a room, which takes a level; a key of the root; a key of one section, without its
    name (`n_agents=3`) or with it (`env={"n_agents": 3}`, `**{"env.n_agents": 3}`). `plugins`
    names packages whose levels are available from then on, as by `use_plugins`.

    Raises BadInput for a keyword that names no key or several, and a value that no setting takes.
    """
    use_plugins(keywords.get(PLUGINS, ()))
    keywords = {key: value for key, value in keywords.items() if key != PLUGINS}
    overrides = with_floor_plans(_listed(settings))
    rooms = groups()
    levels: list[str] = []
    values: dict[str, Any] = {}
    for key, value in keywords.items():
        if isinstance(value, Mapping) and (key in rooms or key == "evaluation"):
            values |= dict(_of_section(key, value))
        elif key in rooms:
            levels += with_floor_plans([f"{key}={value_text(key, value)}"])
        else:
            values[key] = value
    if CHECKPOINT in values:
        levels.append(f"{CHECKPOINT}={value_text(CHECKPOINT, values.pop(CHECKPOINT))}")
    if not values:
        return [*overrides, *levels]
    known = _known_keys([*overrides, *levels])
    named = {_full_name(key, known): value for key, value in values.items()}
    return [
        *overrides,
        *levels,
        *(f"{key}={value_text(key, value)}" for key, value in named.items()),
    ]


def _listed(settings: Settings) -> Sequence[str]:
    """Settings as a list. Raises BadInput for a single setting outside a list."""
    if settings is None:
        return ()
    if not isinstance(settings, str):
        return [str(setting) for setting in settings]
    if "=" in settings:
        raise BadInput(f"{settings!r}: give a list, [{settings!r}], or a keyword for each setting")
    return [f"{EXPERIMENT}={settings}"]


def _of_section(section: str, keys: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Each key of a section by its full name; in a room of several levels, those of each level."""
    for name, value in keys.items():
        if section in SEVERAL and isinstance(value, Mapping):
            yield from _of_section(f"{section}.{name}", value)
        else:
            yield f"{section}.{name}", value


def _known_keys(overrides: Sequence[str]) -> list[str]:
    """Every dotted key of the config with the chosen levels, presets and run.

    Keys that follow another are left out, as a topology's view follows the observation's.
    """
    chosen = [text for text in overrides if _key_of(text) in (*groups(), CHECKPOINT)]
    composed = unchecked(chosen)
    known = dict.fromkeys(dotted_keys(composed))
    if composed.get(CHECKPOINT) is not None:
        known |= dict.fromkeys(dotted_keys(load_config(find_run(str(composed[CHECKPOINT])))))
    follows = {key for key, value in leaves(composed) if str(value).startswith("${")}
    return [key for key in known if key not in follows and not key.endswith("_target_")]


def _key_of(override: str) -> str:
    return override.partition("=")[0].removeprefix("+")


def _full_name(key: str, known: Sequence[str]) -> str:
    """The dotted key that a keyword names. Raises BadInput where it matches none or several."""
    if key in known or "." in key:  # a wrong full name is refused by the commands' check
        return key
    matches = [name for name in known if name.rpartition(".")[2] == key]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise BadInput(
            f"{key}: is a key of several sections: {', '.join(matches)}; write"
            f' **{{"{matches[0]}": ...}} or the like'
        )
    short = {name.rpartition(".")[2]: name for name in known}
    close = difflib.get_close_matches(key, [*short, *groups()], n=NEAREST)
    if close:
        nearest = ", ".join(short.get(name, name) for name in close)
        raise BadInput(f"{key}: no such key; did you mean {nearest}?")
    roots = [name for name in known if "." not in name]
    raise BadInput(f"{key}: no such key; valid: {', '.join(roots)}, or a key of one of these")


def value_text(key: str, value: Any) -> str:
    """A value as the text of an override. Raises BadInput for a type that no setting takes."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Enum):
        return value_text(key, value.value)
    if isinstance(value, str | Path):
        return _quoted(str(value))
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, Mapping):
        return (
            "{" + ",".join(f"{name}:{value_text(key, item)}" for name, item in value.items()) + "}"
        )
    if isinstance(value, Sequence):
        return "[" + ",".join(value_text(key, item) for item in value) + "]"
    valid = "a number, a string, true or false, None, a list or a dict of these"
    raise BadInput(f"{key}: a {type(value).__name__} is no setting; valid: {valid}")


def _quoted(text: str) -> str:
    """A string unchanged, or in quotes where Hydra would read something else."""
    if BARE.fullmatch(text) and text.lower() not in RESERVED:
        return text
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", text)  # backslashes count only before a quote
    trailing = len(escaped) - len(escaped.rstrip("\\"))
    return f"'{escaped}{trailing * chr(92)}'"
