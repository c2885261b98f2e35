"""Whether the values of a config's sections are what their constructors accept."""

import difflib
import importlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from typing import Any, get_type_hints

from omegaconf import DictConfig, OmegaConf
from pydantic import TypeAdapter, ValidationError

from marl_clean.config.class_source import parameters, records
from marl_clean.config.levels import problem_of_target
from marl_clean.config.type_words import describe, options
from marl_clean.errors import BadInput


@dataclass(frozen=True)
class Problem:
    """What is wrong with one key."""

    key: str
    reason: str


def problems_of_level(section: Mapping[str, Any], key: str, room: str) -> Iterator[Problem]:
    """Everything wrong with one level's section, such as `comm` or `logger.csv`."""
    target = section.get("_target_")
    if (reason := problem_of_target(target, room)) is not None:
        yield Problem(f"{key}._target_", reason)
        return
    assert isinstance(target, str)
    try:
        accepted = parameters(target)
    except BadInput as error:
        yield Problem(f"{key}._target_", str(error))
        return
    values = {name: value for name, value in section.items() if name != "_target_"}
    required = [name for name, parameter in accepted.items() if parameter.required]
    types_ = {name: parameter.annotation for name, parameter in accepted.items()}
    yield from problems_of_mapping(values, types_, f"{key}.", required)


def problems_of_mapping(
    values: Mapping[str, Any], accepted: Mapping[str, Any], prefix: str, required: Iterable[str]
) -> Iterator[Problem]:
    """Everything wrong with `values`, whose keys must have the types in `accepted`.

    A key whose type is a dataclass is a section of these: its own keys are checked one by one.
    """
    for name, value in values.items():
        if name not in accepted:
            yield Problem(f"{prefix}{name}", f"no such key; {choices(str(name), accepted)}")
        elif is_dataclass(accepted[name]) and isinstance(value, Mapping):
            inner = get_type_hints(accepted[name], include_extras=True)
            yield from problems_of_mapping(value, inner, f"{prefix}{name}.", ())
        elif reason := mismatch(value, accepted[name]):
            yield Problem(f"{prefix}{name}", reason)
    for name in required:
        if name not in values:
            yield Problem(f"{prefix}{name}", f"is missing; needs {describe(accepted[name])}")


def mismatch(value: Any, annotation: Any) -> str | None:
    """Why `value` is not an `annotation`, in a few words; None when it is."""
    try:
        convert(value, annotation)
    except ValidationError as error:
        messages = [e["msg"] for e in error.errors() if e["type"] == "value_error"]
        if messages:
            return messages[0].removeprefix("Value error, ")
        reason = f"must be {describe(annotation)}, not {json.dumps(value)[:80]}"
        close = difflib.get_close_matches(str(value), list(options(annotation)), n=1)
        return f"{reason}; did you mean {close[0]}?" if close else reason
    return None


def convert(value: Any, annotation: Any) -> Any:
    """`value` as an `annotation`: a name as its Enum, an int as a float, nothing else.

    JSON mode is what makes pydantic strict and yet accept what yaml can say.
    """
    return _validator(annotation)(json.dumps(value), strict=True)


def instantiate(section: DictConfig, **parts: Any) -> Any:
    """What a section describes: its `_target_`, called with its values and with `parts`.

    Values arrive as what the constructor declares: an Enum for its name, a list for a list.
    A part replaces a value of the same name. Fields of a record are gathered into it.
    """
    values = OmegaConf.to_container(section, resolve=True)
    assert isinstance(values, dict)
    target = str(values.pop("_target_"))
    accepted = parameters(target)
    converted = {
        str(name): convert(value, accepted[str(name)].annotation) for name, value in values.items()
    }
    arguments = {**converted, **parts}
    for name, record in records(target).items():
        fields = {field: arguments.pop(field) for field in record.fields & arguments.keys()}
        arguments[name] = _class(record.target)(**fields)
    return _class(target)(**arguments)


def _class(target: str) -> Any:
    module, _, name = target.rpartition(".")
    return getattr(importlib.import_module(module), name)


def choices(word: str, valid: Iterable[str]) -> str:
    """The nearest of `valid` to `word`, and all of them, as the end of a message."""
    names = [name for name in sorted(valid) if not name.startswith("_")]
    if not names:
        return "there are none here"
    close = difflib.get_close_matches(word, names, n=1)
    nearest = f"did you mean {close[0]}? " if close else ""
    return f"{nearest}valid: {', '.join(names)}"


@cache
def _validator(annotation: Any) -> Callable[..., Any]:
    return TypeAdapter(annotation).validate_json
