"""Yaml from outside: small, plain data only, no anchors, no tags."""

import reprlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from marl_clean.errors import BadInput
from marl_clean.storage.reading import TooLarge, read_bytes

LARGEST_BYTES = 1 << 20
MOST_VALUES = 30_000
DEEPEST = 20  # sections inside sections
LONGEST_KEY = 100  # characters
LONGEST_WHOLE = 40  # characters: 64 bits in any base that yaml has
BASE, SAFE = (  # libyaml's loaders read the same ten times as fast
    (yaml.CBaseLoader, yaml.CSafeLoader)
    if yaml.__with_libyaml__
    else (yaml.BaseLoader, yaml.SafeLoader)
)
BUILT = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("bool", "int", "float", "null"))


class Plain(SAFE):  # type: ignore[misc, valid-type]
    """Builds mappings, lists, str, int, float, bool and null alone: a date stays text."""

    yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag in BUILT]
        for first, resolvers in SAFE.yaml_implicit_resolvers.items()
    }

    def construct_whole(self, node: yaml.ScalarNode) -> int:
        """A whole number. Raises ValueError for a longer one than any setting takes."""
        if len(node.value) > LONGEST_WHOLE:
            raise ValueError("a whole number longer than 64 bits")
        return int(self.construct_yaml_int(node))


Plain.add_constructor("tag:yaml.org,2002:int", Plain.construct_whole)


def load_yaml(path: Path) -> Any:
    """The data in a yaml file: mappings with texts as keys, lists, texts, numbers, bools, null.

    A few hundred bytes of nested anchors can stand for gigabytes, and a few thousand brackets
    take seconds, so both are refused. Raises BadInput when the file cannot be read, is larger
    than 1 MiB or is no such yaml.
    """
    try:
        text = read_bytes(path, LARGEST_BYTES).decode("utf-8")
        check_plain(text, path, DEEPEST)
        tree = yaml.load(text, Loader=Plain)
    except TooLarge as error:
        raise BadInput(f"{path}: larger than 1 MiB; not a settings file") from error
    except BadInput as error:
        if isinstance(cause := error.__cause__, OSError):
            reason = f"{cause.strerror}; give a yaml file that can be read"
            raise BadInput(f"{path}: {reason}") from error
        raise
    except (yaml.YAMLError, ValueError) as error:  # ValueError: not UTF-8, or no such number
        raise BadInput(f"{path}: not plain yaml ({reason_of(error)})") from error
    for key in _keys(tree):
        if not isinstance(key, str):
            raise BadInput(f"{path}: the key {reprlib.repr(key)} is no text; write it in quotes")
        if len(key) > LONGEST_KEY:
            raise BadInput(f"{path}: the key {reprlib.repr(key)} is longer than {LONGEST_KEY}")
    return tree


def reason_of(error: Exception) -> str:
    """What a yaml parser found, on one short line."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem and error.problem_mark:
        return f"{error.problem}, line {error.problem_mark.line + 1}"
    return str(error).splitlines()[0]


def check_plain(text: str, path: Path, deepest: int) -> None:
    """Check yaml as a stream of events, which builds nothing, before it is loaded.

    Raises BadInput for anchors, aliases and tags, for more than 30,000 values, for sections nested
    deeper than `deepest` and for a key that stands twice in one section, and yaml.YAMLError for
    invalid yaml.
    """
    depth = count = 0
    sections = _OpenSections()
    for event in yaml.parse(text, Loader=BASE):
        if isinstance(event, yaml.NodeEvent):
            count += 1
            if event.anchor is not None:
                raise BadInput(
                    f"{path}: yaml anchors and aliases are not read; write the values out"
                )
            if getattr(event, "tag", None) is not None:
                raise BadInput(f"{path}: not plain yaml, the tag {reprlib.repr(event.tag)}")
        if count > MOST_VALUES:
            raise BadInput(f"{path}: not plain yaml, more than {MOST_VALUES:,} values")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > deepest:
            raise BadInput(f"{path}: not plain yaml, nested more than {deepest} sections deep")
        if (twice := sections.repeated(event)) is not None:
            raise BadInput(f"{path}: the key {reprlib.repr(twice)} stands twice; once is valid")


def _keys(tree: Any) -> Iterator[Any]:
    """The keys of all mappings in a tree."""
    if isinstance(tree, dict):
        yield from tree
        tree = list(tree.values())
    if isinstance(tree, list):
        for value in tree:
            yield from _keys(value)


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
