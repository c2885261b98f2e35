"""Types of settings in words, for messages: "a whole number, at least 1"."""

import enum
import types
import typing
from collections.abc import Iterator
from typing import Any

from pydantic.fields import FieldInfo

KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def describe(annotation: Any) -> str:
    """A type in words: "a whole number, at least 1"."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        limits = [text for part in arguments[1:] for text in _limits(part)]
        return ", ".join([describe(arguments[0]), *limits])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(describe(argument) for argument in arguments)
    if origin in (list, tuple):
        return f"a list, each {describe(arguments[0])}" if arguments else "a list"
    if named := options(annotation):
        return f"one of {', '.join(named)}"
    if annotation is type(None):
        return "null"
    return KINDS.get(annotation, "a section")


def options(annotation: Any) -> tuple[str, ...]:
    """The words an Enum or a Literal allows, also inside `| None`."""
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return tuple(str(member.value) for member in annotation)
    if typing.get_origin(annotation) is typing.Literal:
        return tuple(map(str, typing.get_args(annotation)))
    inner = typing.get_args(annotation)
    return tuple(option for part in inner for option in options(part))


def _limits(part: Any) -> Iterator[str]:
    """The bounds of an `Annotated` type in words."""
    words = {
        "ge": "at least {}",
        "gt": "more than {}",
        "le": "at most {}",
        "lt": "less than {}",
        "min_length": "no fewer than {}",
        "max_length": "no more than {}",
    }
    for constraint in part.metadata if isinstance(part, FieldInfo) else [part]:
        for name, text in words.items():
            limit = getattr(constraint, name, None)
            if limit is not None:
                yield text.format(limit)
