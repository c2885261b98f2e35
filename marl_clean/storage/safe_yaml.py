"""Yaml from outside: small, plain data only, no anchors."""

import reprlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from marl_clean.errors import BadInput

LARGEST_BYTES = 1 << 20
DEEPEST = 20  # sections inside sections
BASE, SAFE = (  # libyaml's loaders read the same ten times as fast
    (yaml.CBaseLoader, yaml.CSafeLoader)
    if yaml.__with_libyaml__
    else (yaml.BaseLoader, yaml.SafeLoader)
)


def load_yaml(path: Path) -> Any:
    """The data in a yaml file: mappings, lists, texts, numbers.

    A few hundred bytes of nested anchors can stand for gigabytes, and a few thousand brackets
    take seconds, so both are refused. Raises BadInput when the file cannot be read, is larger
    than 1 MiB or is no such yaml.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise BadInput(f"{path}: larger than 1 MiB; not a settings file")
        text = path.read_text(encoding="utf-8")
        check_plain(text, path, DEEPEST)
        return yaml.load(text, Loader=SAFE)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a yaml file that can be read") from error
    except BadInput:
        raise
    except (yaml.YAMLError, ValueError) as error:  # ValueError: not UTF-8, or no such date
        reason = str(error).splitlines()[0]
        raise BadInput(f"{path}: not plain yaml ({reason})") from error


def check_plain(text: str, path: Path, deepest: int) -> None:
    """Check yaml as a stream of events, which builds nothing, before it is loaded.

    Raises BadInput for anchors and aliases, for sections nested deeper than `deepest` and for a
    key that stands twice in one section, and yaml.YAMLError for invalid yaml.
    """
    depth = 0
    sections = _OpenSections()
    for event in yaml.parse(text, Loader=BASE):
        if isinstance(event, yaml.NodeEvent) and event.anchor is not None:
            raise BadInput(f"{path}: yaml anchors and aliases are not read; write the values out")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > deepest:
            raise BadInput(f"{path}: not plain yaml, nested more than {deepest} sections deep")
        if (twice := sections.repeated(event)) is not None:
            raise BadInput(f"{path}: the key {reprlib.repr(twice)} stands twice; once is valid")


class _OpenSections:
    """Follows the events of a yaml and the keys that each open section has had so far."""

    def __init__(self) -> None:
        self.open: list[_Section] = []

    def repeated(self, event: yaml.Event) -> str | None:
        """The key that `event` writes a second time, if it does."""
        if isinstance(event, yaml.CollectionEndEvent):
            self.open.pop()
        if not isinstance(event, yaml.NodeEvent):
            return None
        section = self.open[-1] if self.open else None
        twice = None
        if section is not None and section.is_mapping:
            if section.key_is_next and isinstance(event, yaml.ScalarEvent):
                twice = event.value if event.value in section.keys else None
                section.keys.add(event.value)
            section.key_is_next = not section.key_is_next
        if isinstance(event, yaml.CollectionStartEvent):
            self.open.append(_Section(isinstance(event, yaml.MappingStartEvent)))
        return twice


@dataclass
class _Section:
    """An open mapping or list of a yaml."""

    is_mapping: bool
    key_is_next: bool = True
    keys: set[str] = field(default_factory=set)
