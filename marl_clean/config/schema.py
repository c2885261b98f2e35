"""What a section of the config accepts, read from its constructor's signature.

`_target_: marl_clean.house.rooms.Rooms` names the file and the class; `ast` reads the
annotations of its `__init__` without importing it, so a wrong setting is refused before torch
is loaded. A parameter whose annotation is not made of builtins and `marl_clean.settings` (a
network, an env) is handed over in code and is no key of the config.
"""

import ast
import builtins
import difflib
import importlib
import json
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from pydantic import TypeAdapter, ValidationError

from marl_clean import settings
from marl_clean.config.type_words import describe, options
from marl_clean.errors import BadInput

PACKAGE = Path(__file__).parents[1]
TARGET = re.compile(r"marl_clean((?:\.[a-z]\w*)+)\.([A-Za-z]\w*)")


@dataclass(frozen=True)
class Parameter:
    """One key of a section: the type it must have, and whether it may be left out."""

    annotation: Any
    required: bool


@dataclass(frozen=True)
class Problem:
    """What is wrong with one key."""

    key: str
    reason: str


def parameters(target: str) -> dict[str, Parameter]:
    """The parameters of `target`'s constructor that a config can set, by name.

    Raises BadInput when `target` is no class of this package.
    """
    return _of_class(*_locate(target))


def definition(target: str) -> ast.ClassDef:
    """The class statement of `target`. Raises BadInput when it is no class of this package."""
    return _class_in(*_locate(target))


def constant(target: str, name: str) -> Any:
    """What the body of the class `target`, or the nearest base that has it, sets `name` to.

    None where none does.
    """
    place: tuple[Path, str] | None = _locate(target)
    while place is not None:
        source, node = place[0], _class_in(*place)
        for item in node.body:
            if isinstance(item, ast.Assign) and [ast.unparse(t) for t in item.targets] == [name]:
                return _evaluate(item.value)
        inherited = (_import_of(source, ast.unparse(base)) for base in node.bases)
        place = next(filter(None, inherited), None)
    return None


def takes(target: str, part: str) -> bool:
    """Whether the constructor of `target` has a parameter of this name, for a key or in code."""
    constructors = (
        item.args
        for item in definition(target).body
        if isinstance(item, ast.FunctionDef) and item.name == "__init__"
    )
    return any(part == a.arg for args in constructors for a in (*args.args, *args.kwonlyargs))


def problems_of_level(section: Mapping[str, Any], key: str, room: str) -> Iterator[Problem]:
    """Everything wrong with one level's section, such as `comm` or `logger.csv`."""
    target = section.get("_target_")
    if not isinstance(target, str) or not target.startswith(f"marl_clean.{room}."):
        yield Problem(f"{key}._target_", f"must name a class in marl_clean.{room}, not {target!r}")
        return
    try:
        accepted = parameters(target)
    except BadInput as error:
        yield Problem(f"{key}._target_", str(error))
        return
    given = {name: value for name, value in section.items() if name != "_target_"}
    required = [name for name, parameter in accepted.items() if parameter.required]
    types_ = {name: parameter.annotation for name, parameter in accepted.items()}
    yield from problems_of_mapping(given, types_, f"{key}.", required)


def problems_of_mapping(
    given: Mapping[str, Any], accepted: Mapping[str, Any], prefix: str, required: Iterable[str]
) -> Iterator[Problem]:
    """Everything wrong with `given`, whose keys must have the types in `accepted`."""
    for name, value in given.items():
        if name not in accepted:
            yield Problem(f"{prefix}{name}", f"no such key; {choices(str(name), accepted)}")
        elif reason := mismatch(value, accepted[name]):
            yield Problem(f"{prefix}{name}", reason)
    for name in required:
        if name not in given:
            yield Problem(f"{prefix}{name}", f"is missing; needs {describe(accepted[name])}")


def mismatch(value: Any, annotation: Any) -> str | None:
    """Why `value` is not an `annotation`, in a few words; None when it is one."""
    try:
        convert(value, annotation)
    except ValidationError as error:
        said = [e["msg"] for e in error.errors() if e["type"] == "value_error"]
        if said:
            return said[0].removeprefix("Value error, ")
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
    A part of the same name takes a value's place.
    """
    values = OmegaConf.to_container(section, resolve=True)
    assert isinstance(values, dict)
    target = str(values.pop("_target_"))
    accepted = parameters(target)
    converted = {
        str(name): convert(value, accepted[str(name)].annotation) for name, value in values.items()
    }
    module, _, name = target.rpartition(".")
    return getattr(importlib.import_module(module), name)(**{**converted, **parts})


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


def _locate(target: str) -> tuple[Path, str]:
    """The file and the class that a `_target_` names."""
    match = TARGET.fullmatch(target)
    if match is None:
        raise BadInput(f"{target!r} is not a class of marl_clean")
    source = PACKAGE.joinpath(*match[1].split(".")[1:]).with_suffix(".py")
    if not source.is_file():
        raise BadInput(f"{target!r}: there is no file marl_clean/{source.relative_to(PACKAGE)}")
    return source, match[2]


@cache
def _parse(source: Path) -> ast.Module:
    """The syntax tree of one of the package's files."""
    return ast.parse(source.read_text(encoding="utf-8"))


def _of_class(source: Path, name: str) -> dict[str, Parameter]:
    return _of_definition(source, _class_in(source, name))


def _class_in(source: Path, name: str) -> ast.ClassDef:
    for node in _parse(source).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            return node
    raise BadInput(f"marl_clean/{source.relative_to(PACKAGE)} has no class {name}")


def _of_definition(source: Path, node: ast.ClassDef) -> dict[str, Parameter]:
    for item in node.body:
        if isinstance(item, ast.FunctionDef) and item.name == "__init__":
            return dict(_of_arguments(item.args))
    if any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
        return dict(_of_fields(node))
    for base in map(ast.unparse, node.bases):
        if (inherited := _import_of(source, base)) is not None:
            return _of_class(*inherited)
    return {}


def _of_arguments(arguments: ast.arguments) -> Iterator[tuple[str, Parameter]]:
    positional = [*arguments.posonlyargs, *arguments.args][1:]  # without self
    required = len(positional) - len(arguments.defaults)
    pairs = [(argument, i < required) for i, argument in enumerate(positional)]
    pairs += [
        (argument, default is None)
        for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    ]
    for argument, is_required in pairs:
        annotation = _evaluate(argument.annotation)
        if annotation is not None:
            yield argument.arg, Parameter(annotation, is_required)


def _of_fields(node: ast.ClassDef) -> Iterator[tuple[str, Parameter]]:
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            annotation = _evaluate(item.annotation)
            if annotation is not None and "ClassVar" not in ast.unparse(item.annotation):
                yield item.target.id, Parameter(annotation, item.value is None)


def _import_of(source: Path, name: str) -> tuple[Path, str] | None:
    """Where a class that `source` imports from this package is defined."""
    for node in _parse(source).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("marl_clean."):
            if any(alias.name == name for alias in node.names):
                return _locate(f"{node.module}.{name}")
    return None


def _evaluate(annotation: ast.expr | None) -> Any | None:
    """The type an annotation spells, or None when it needs more than `settings` and builtins."""
    if annotation is None:
        return None
    simple = {name: getattr(builtins, name) for name in ("int", "float", "bool", "str")}
    containers = {"list": list, "tuple": tuple, "dict": dict, "Literal": typing.Literal}
    names = {**simple, **containers, **vars(settings), "__builtins__": {}}
    try:
        evaluated = eval(ast.unparse(annotation), names)  # the package's own source, never input
    except (NameError, AttributeError, TypeError):
        return None
    return None if isinstance(evaluated, str) else evaluated  # a quoted forward reference
