"""Writes the tables of rooms and settings into the pages, from conf/ itself, so none goes stale."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from marl_clean.commands.listing import claim
from marl_clean.config.compose import compose_config
from marl_clean.config.levels import PRESETS, SEVERAL, conf_folder, groups, read_level, rooms

ROOMS = "<!-- table of rooms -->"
SETTINGS = "<!-- tables of settings -->"
PRESET_LIST = "<!-- table of presets -->"
INTERVAL = re.compile(r" \[([+-]?[\d.]+), ([+-]?[\d.]+)\]")
PERCENT = re.compile(r"(\d) %")
KEY = re.compile(r"\s*(?:- )?(\w+):[^#]*#\s*(.*)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in the tables where a page has their marks; in all tables keep a figure on one line."""
    for mark, table in ((ROOMS, rooms_table), (SETTINGS, settings), (PRESET_LIST, presets_table)):
        if mark in markdown:
            markdown = markdown.replace(mark, "\n".join(table()))
    return "\n".join(map(unbroken, markdown.split("\n")))


def unbroken(line: str) -> str:
    """A line of a table whose intervals and percentages do not break."""
    if not line.startswith("|"):
        return line
    return PERCENT.sub(r"\1&nbsp;%", INTERVAL.sub(r"&nbsp;[\1,&nbsp;\2]", line))


def rooms_table() -> Iterator[str]:
    """A line a room: its levels, the default first named, and what the room decides."""
    asks = comments(conf_folder() / "config.yaml")
    yield "| room | levels | decides |"
    yield "|---|---|---|"
    for room in sorted(rooms(), key=list(asks).index):
        levels = rooms()[room]
        yield f"| `{room}` | {' '.join(f'`{level}`' for level in levels)} | {asks[room]} |"


def presets_table() -> Iterator[str]:
    """A line a preset: the comment that its file begins with."""
    yield "| preset | is |"
    yield "|---|---|"
    for group in PRESETS:
        for name in groups()[group]:
            lines = (conf_folder() / group / f"{name}.yaml").read_text().splitlines()[1:]
            words = []
            for line in lines:
                if not line.startswith("# "):
                    break
                words.append(line.removeprefix("# "))
            text = " ".join(word for word in words if not word.startswith("  "))
            yield f"| `{'+' if group == 'experiment' else ''}{group}={name}` | {cell(text)} |"


def settings() -> Iterator[str]:
    """A section a room, a table a level: every key, its default and its comment."""
    yield from ("### Of the whole experiment", "", *root_table(), "")
    for room, levels in rooms().items():
        yield from (f"### {room}", "")
        for level in levels:
            claims = claim(read_level(room, level)["_target_"])
            yield from (f"**`{room}={level}`**: {claims}", "", *level_table(room, level), "")


def root_table() -> Iterator[str]:
    """The keys that belong to no room."""
    known = comments(conf_folder() / "config.yaml")
    config = compose_config()
    flat = {key: value for key, value in config.items() if key not in {*rooms(), "evaluation"}}
    flat |= {f"evaluation.{key}": value for key, value in config.evaluation.items()}
    flat = {str(key): value for key, value in flat.items() if str(key).split(".")[-1] in known}
    yield from table(flat | {"name": None}, known)


def level_table(room: str, level: str) -> Iterator[str]:
    """The keys of one level, with the defaults that a run has."""
    section = compose_config([f"{room}={level}"])[room]
    prefix = f"{room}.{level}" if room in SEVERAL else room
    section = section[level] if room in SEVERAL else section
    folder = conf_folder() / room
    known: dict[str, str] = {}
    for file in (*sorted(folder.glob("_*.yaml")), folder / f"{level}.yaml"):
        known |= comments(file)
    keys = {f"{prefix}.{key}": value for key, value in section.items() if key != "_target_"}
    if keys:
        yield from table(keys, known)


def table(values: Mapping[str, Any], known: Mapping[str, str]) -> Iterator[str]:
    """Key, default, meaning."""
    yield "| key | default | meaning |"
    yield "|---|---|---|"
    for key, value in values.items():
        shown = OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
        text = "null" if shown is None else str(shown).lower() if shown in (True, False) else shown
        yield f"| `{key}` | `{text}` | {cell(known.get(key.split('.')[-1], ''))} |"


def comments(file: Path) -> dict[str, str]:
    """What a yaml says beside each of its keys."""
    matches = (KEY.match(line) for line in file.read_text(encoding="utf-8").splitlines())
    return {match[1]: match[2] for match in matches if match}


def cell(text: str) -> str:
    """Text as a cell of a table."""
    return text.replace("|", r"\|")
