"""What a class declares, read from its source without importing it.

`_target_: marl_clean.house.rooms.Rooms` names a module and a class; `ast` reads the annotations
of its `__init__` and the constants of its body, so a config is checked before torch is loaded.
"""

import ast
import builtins
import re
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from marl_clean import settings
from marl_clean.config.locate import file_of
from marl_clean.errors import BadInput

TARGET = re.compile(r"([a-z]\w*(?:\.[a-z]\w*)+)\.([A-Za-z]\w*)")
SIMPLE = {name: getattr(builtins, name) for name in ("int", "float", "bool", "str")}
T = typing.TypeVar("T")
CONTAINERS = {"list": list, "tuple": tuple, "dict": dict, "Literal": typing.Literal}


@dataclass(frozen=True)
class Parameter:
    """One key of a section: the type it must have, and whether it may be left out."""

    annotation: Any
    required: bool


@dataclass(frozen=True)
class Record:
    """A parameter that is a dataclass of settings: a config gives its fields, one key each."""

    target: str
    fields: frozenset[str]


@dataclass(frozen=True)
class ClassSource:
    """A class statement, and the module that it stands in."""

    module: str
    node: ast.ClassDef

    def bases(self) -> Iterator["ClassSource"]:
        """The bases that are classes of our packages, in their order.

        Raises BadInput for a base whose definition cannot be located.
        """
        for base in self.node.bases:
            dotted = ast.unparse(base.value if isinstance(base, ast.Subscript) else base)
            first = dotted.partition(".")[0]
            if (source := _class_called(self.module, dotted)) is not None:
                yield source
            elif first not in _imports(self.module) and not hasattr(builtins, first):
                raise BadInput(
                    f"{self.where(base)}: the base {dotted} cannot be read without running it; "
                    "define it by a class statement in this file, or import it"
                )

    def lineage(self) -> Iterator["ClassSource"]:
        """The class itself, then its bases of our packages, the nearest first."""
        yield self
        for base in self.bases():
            yield from base.lineage()

    def where(self, node: ast.stmt | ast.expr) -> str:
        """Class and line of something in it, for messages."""
        return f"{self.module}.{self.node.name}, line {node.lineno}"


def class_of(target: str) -> ClassSource:
    """The source of the class that `target` names.

    Raises BadInput when it is no class of our packages.
    """
    match = TARGET.fullmatch(target)
    if match is None or (path := file_of(match[1])) is None:
        raise BadInput(f"{target!r} is not a class of marl_clean: there is no file of it")
    if (source := _class_in(match[1], match[2])) is None:
        raise BadInput(f"{target!r}: there is no class {match[2]} in {path.name}")
    return source


def definition(target: str) -> ast.ClassDef:
    """The class statement of `target`. Raises BadInput when it is no class of our packages."""
    return class_of(target).node


def parameters(target: str) -> dict[str, Parameter]:
    """The parameters of `target`'s constructor that a config can set, by name.

    One whose annotation is not made of builtins and `marl_clean.settings` (a network, an env) is
    passed in code and left out. One whose default is a record, as in `rules: Rules = Rules()`,
    stands for the record's fields. Raises BadInput when `target` is no class of our packages.
    """
    return dict(_parameters(class_of(target)))


def records(target: str) -> dict[str, Record]:
    """The parameters of `target`'s constructor that are records, by name."""
    return dict(_records(class_of(target)))


def takes(target: str, part: str) -> bool:
    """Whether the constructor of `target` has a parameter named `part`, of any type."""
    return any(part == argument.arg for _, argument, _ in _arguments(class_of(target)))


def constant(target: str, name: str) -> Any:
    """What the body of the class `target`, or the nearest base that has it, sets `name` to.

    None where no class sets it; an annotation without a value sets nothing. Raises BadInput, naming
    class and line, where its value is not made of literals and names of `marl_clean.settings`.
    """
    if (found := _statement(class_of(target), name)) is None:
        return None
    source, item = found
    try:
        return _evaluate(_value_set(item))
    except (ArithmeticError, AttributeError, LookupError, NameError, TypeError, ValueError):
        raise BadInput(
            f"{source.where(item)}: {name} cannot be read without running it; write it "
            "out in the class's body, of literals and names of marl_clean.settings"
        ) from None


@cache
def _statement(source: ClassSource, name: str) -> tuple[ClassSource, ast.stmt] | None:
    """What sets `name` in the body of the class, or of the nearest base that has it."""
    for owner in source.lineage():
        for item in owner.node.body:
            if name in _names_set(item):
                return owner, item
    return None


def _names_set(item: ast.stmt) -> set[str]:
    """The names that a statement of a class's body assigns."""
    if isinstance(item, ast.AnnAssign) and item.value is None:
        return set()
    if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {item.name}
    return {
        node.id
        for node in ast.walk(item)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def _value_set(item: ast.stmt) -> ast.expr:
    """What `name = value` or `name: type = value` sets. Raises TypeError for other statements."""
    if isinstance(item, ast.AnnAssign) and item.value is not None:
        return item.value
    if isinstance(item, ast.Assign) and all(isinstance(t, ast.Name) for t in item.targets):
        return item.value
    raise TypeError(type(item))


@cache
def _parse(module: str) -> ast.Module:
    """The syntax tree of a module, empty for a module outside our packages."""
    path = file_of(module)
    return ast.parse(path.read_text(encoding="utf-8") if path else "")


def _class_in(module: str, name: str) -> ClassSource | None:
    for node in _parse(module).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            return ClassSource(module, node)
    return None


def _class_called(module: str, dotted: str) -> ClassSource | None:
    """The class of our packages that a module calls `dotted`: its own, or one it imports."""
    first, _, rest = dotted.partition(".")
    if not rest and (own := _class_in(module, first)) is not None:
        return own
    if (imported := _imports(module).get(first)) is None:
        return None
    origin, _, name = ".".join(filter(None, [imported, rest])).rpartition(".")
    return _class_called(origin, name) if file_of(origin) else None


@cache
def _imports(module: str) -> dict[str, str]:
    """What the names that a module imports stand for."""
    path = file_of(module)
    parts = module.split(".")
    package = parts if path is not None and path.name == "__init__.py" else parts[:-1]
    names: dict[str, str] = {}
    for node in ast.walk(_parse(module)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                whole = alias.name if alias.asname else alias.name.partition(".")[0]
                names[alias.asname or whole] = whole
        elif isinstance(node, ast.ImportFrom):
            upwards = package[: len(package) + 1 - node.level] if node.level else []
            origin = ".".join([*upwards, *filter(None, [node.module])])
            names |= {alias.asname or alias.name: f"{origin}.{alias.name}" for alias in node.names}
    return names


def _kept(read: Callable[[ClassSource], Iterator[T]]) -> Callable[[ClassSource], tuple[T, ...]]:
    """Read each class once: it is asked for whenever something is made of a config."""
    return cache(lambda source: tuple(read(source)))


@cache
def _constructor(source: ClassSource) -> tuple[ClassSource, ast.FunctionDef | None] | None:
    """The nearest class that defines its constructor, and its `__init__`; None for a dataclass."""
    for owner in source.lineage():
        for item in owner.node.body:
            if isinstance(item, ast.FunctionDef) and item.name == "__init__":
                return owner, item
        if _is_dataclass(owner):
            return owner, None
    return None


def _arguments(source: ClassSource) -> Iterator[tuple[ClassSource, ast.arg, ast.expr | None]]:
    """The arguments of the nearest `__init__`: the class it stands in, argument and default."""
    match _constructor(source):
        case (owner, ast.FunctionDef(args=signature)):
            positional = [*signature.posonlyargs, *signature.args]
            required: list[None] = [None] * (len(positional) - len(signature.defaults))
            for argument, default in (
                *zip(positional, [*required, *signature.defaults], strict=True),
                *zip(signature.kwonlyargs, signature.kw_defaults, strict=True),
            ):
                yield owner, argument, default


@_kept
def _parameters(source: ClassSource) -> Iterator[tuple[str, Parameter]]:
    match _constructor(source):
        case (owner, None):
            yield from _settings(owner)
    for _, argument, default in _arguments(source):
        if (annotation := _type(argument.annotation)) is not None:
            yield argument.arg, Parameter(annotation, default is None)
    for _, record in _records(source):
        yield from _settings(class_of(record.target))


@_kept
def _records(source: ClassSource) -> Iterator[tuple[str, Record]]:
    for owner, argument, default in _arguments(source):
        if isinstance(default, ast.Call) and not default.args and not default.keywords:
            record = _class_called(owner.module, ast.unparse(default.func))
            if record is not None and _is_dataclass(record):
                names = frozenset(ast.unparse(field.target) for field in _fields(record))
                yield argument.arg, Record(f"{record.module}.{record.node.name}", names)


def _settings(source: ClassSource) -> Iterator[tuple[str, Parameter]]:
    """The fields of a dataclass that a config can set."""
    for field in _fields(source):
        if (annotation := _type(field.annotation)) is not None:
            yield ast.unparse(field.target), Parameter(annotation, field.value is None)


def _fields(source: ClassSource) -> Iterator[ast.AnnAssign]:
    """The fields that the constructor of a dataclass takes, those of its bases first."""
    for base in source.bases():
        if _is_dataclass(base):
            yield from _fields(base)
    yield from filter(_is_field, source.node.body)


def _is_field(item: ast.stmt) -> typing.TypeGuard[ast.AnnAssign]:
    """Whether a statement is a field of a dataclass that its constructor takes."""
    if not isinstance(item, ast.AnnAssign) or "ClassVar" in ast.unparse(item.annotation):
        return False
    return item.value is None or "init=False" not in ast.unparse(item.value)


def _is_dataclass(source: ClassSource) -> bool:
    return any("dataclass" in ast.unparse(mark) for mark in source.node.decorator_list)


def _type(annotation: ast.expr | None) -> Any | None:
    """The type an annotation names, or None when it needs more than `settings` and builtins."""
    if annotation is None:
        return None
    try:
        evaluated = _evaluate(annotation)
    except (NameError, AttributeError, TypeError):
        return None
    return None if isinstance(evaluated, str) else evaluated  # a quoted forward reference


def _evaluate(expression: ast.expr) -> Any:
    """What an expression of builtin types, literals and names of `settings` stands for."""
    names = {**SIMPLE, **CONTAINERS, **vars(settings), "__builtins__": {}}
    return eval(ast.unparse(expression), names)  # a package's own source, never input
