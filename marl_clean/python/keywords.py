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
from marl_clean.config.compose import dotted_keys, unchecked
from marl_clean.config.levels import EXPERIMENT, SEVERAL, groups
from marl_clean.config.locate import use_plugins
from marl_clean.config.stored import find_run, load_config
from marl_clean.errors import BadInput

Settings = str | Sequence[str] | None
"""A preset by its name, or overrides as on the command line; None: the defaults."""

CHECKPOINT, PLUGINS = "checkpoint", "plugins"
BARE = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
RESERVED = ("null", "true", "false", "nan", "inf")  # words that are no text in a setting
NEAREST = 3


def overrides_of(settings: Settings, keywords: Mapping[str, Any]) -> list[str]:
    """What a Python call asks for as overrides: `settings`, then `keywords`.

    A keyword is a room, which takes a level; a key of the root; a key of one section, without its
    name (`n_agents=3`) or with it (`env={"n_agents": 3}`, `**{"env.n_agents": 3}`). `plugins`
    names packages whose levels are known from then on, as by `use_plugins`.

    Raises BadInput for a keyword that names no key or several, and a value that is no setting.
    """
    use_plugins(keywords.get(PLUGINS, ()))
    keywords = {key: value for key, value in keywords.items() if key != PLUGINS}
    given = with_floor_plans(_listed(settings))
    rooms = groups()
    levels: list[str] = []
    values: dict[str, Any] = {}
    for key, value in keywords.items():
        if isinstance(value, Mapping) and (key in rooms or key == "evaluation"):
            values |= dict(_of_section(key, value))
        elif key in rooms:
            levels += with_floor_plans([f"{key}={_text(key, value)}"])
        else:
            values[key] = value
    if CHECKPOINT in values:
        levels.append(f"{CHECKPOINT}={_text(CHECKPOINT, values.pop(CHECKPOINT))}")
    if not values:
        return [*given, *levels]
    known = _known_keys([*given, *levels])
    named = {_full_name(key, known): value for key, value in values.items()}
    return [*given, *levels, *(f"{key}={_text(key, value)}" for key, value in named.items())]


def _listed(settings: Settings) -> Sequence[str]:
    """Settings as a list. Raises BadInput where a setting stands without one."""
    if settings is None:
        return ()
    if not isinstance(settings, str):
        return [str(setting) for setting in settings]
    if "=" in settings:
        raise BadInput(f"{settings!r}: give a list, [{settings!r}], or a keyword for each setting")
    return [f"{EXPERIMENT}={settings}"]


def _of_section(section: str, keys: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Each key of a section by its full name; of a room of several levels, of each level."""
    for name, value in keys.items():
        if section in SEVERAL and isinstance(value, Mapping):
            yield from _of_section(f"{section}.{name}", value)
        else:
            yield f"{section}.{name}", value


def _known_keys(overrides: Sequence[str]) -> list[str]:
    """Every dotted key of the config that the chosen levels, presets and run have between them.

    Without those that follow another key, as a topology's view does the observation's.
    """
    chosen = [text for text in overrides if _key_of(text) in (*groups(), CHECKPOINT)]
    composed = unchecked(chosen)
    known = dict.fromkeys(dotted_keys(composed))
    if composed.get(CHECKPOINT) is not None:
        known |= dict.fromkeys(dotted_keys(load_config(find_run(str(composed[CHECKPOINT])))))
    follows = {key for key, value in _leaves(composed) if str(value).startswith("${")}
    return [key for key in known if key not in follows and not key.endswith("_target_")]


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _key_of(override: str) -> str:
    return override.partition("=")[0].removeprefix("+")


def _full_name(key: str, known: Sequence[str]) -> str:
    """The dotted key that a keyword means. Raises BadInput where it means none or several."""
    if key in known or "." in key:  # what is wrong with a full name, the commands' check says
        return key
    meant = [name for name in known if name.rpartition(".")[2] == key]
    if len(meant) == 1:
        return meant[0]
    if meant:
        raise BadInput(
            f"{key}: is a key of several sections: {', '.join(meant)}; write"
            f' **{{"{meant[0]}": ...}} or the like'
        )
    short = {name.rpartition(".")[2]: name for name in known}
    close = difflib.get_close_matches(key, [*short, *groups()], n=NEAREST)
    if close:
        nearest = ", ".join(short.get(name, name) for name in close)
        raise BadInput(f"{key}: no such key; did you mean {nearest}?")
    roots = [name for name in known if "." not in name]
    raise BadInput(f"{key}: no such key; valid: {', '.join(roots)}, or a key of one of these")


def _text(key: str, value: Any) -> str:
    """A value in the words of an override. Raises BadInput for what no setting can be."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Enum):
        return _text(key, value.value)
    if isinstance(value, str | Path):
        return _quoted(str(value))
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{name}:{_text(key, one)}" for name, one in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ",".join(_text(key, one) for one in value) + "]"
    valid = "a number, a text, true or false, None, a list or a dict of these"
    raise BadInput(f"{key}: a {type(value).__name__} is no setting; valid: {valid}")


def _quoted(text: str) -> str:
    """A text as it stands, or in quotes where Hydra would read something else."""
    if BARE.fullmatch(text) and text.lower() not in RESERVED:
        return text
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", text)  # backslashes count only before a quote
    trailing = len(escaped) - len(escaped.rstrip("\\"))
    return f"'{escaped}{trailing * chr(92)}'"
