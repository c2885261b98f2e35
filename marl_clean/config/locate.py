"""Where levels come from: this package, and the plugins that a user installed or named.

A plugin is another package with a folder `conf/` in it, laid out as ours. Nothing of it is
imported here: only entry points, folders and files are looked at.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from marl_clean.errors import BadInput

GROUP = "marl_clean.plugins"  # of entry points, each with a package's name as its value
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True)
class Package:
    """A package with levels: its name, its folder, and the folder of its yaml files."""

    name: str
    folder: Path
    conf: Path


@cache
def own() -> Package:
    """This package; its yaml files lie inside it (a wheel) or beside it (a checkout)."""
    package = Path(__file__).parents[1]
    for conf in (package / "conf", package.parent / "conf"):
        if (conf / "config.yaml").is_file():
            return Package(package.name, package, conf)
    raise BadInput(f"no conf/config.yaml in {package} or {package.parent}; install marl-clean anew")


def packages() -> tuple[Package, ...]:
    """Every package whose levels may be used, this one first.

    Raises BadInput where a plugin has a level whose name is already in use.
    """
    by_name = {package.name: package for package in (own(), *_installed(), *_named.values())}
    return _disjoint(tuple(by_name.values()))


def use_plugins(names: Sequence[str]) -> None:
    """Make the levels of these packages available, from now on in this process.

    Raises BadInput where there is no such package, or it is not a plugin.
    """
    if isinstance(names, str):
        raise BadInput(f"plugins: give a list, such as [{names!r}]")
    _named.update({name: _plugin(name) for name in names})
    packages()


@contextmanager
def plugins_in_use(names: Sequence[str]) -> Iterator[None]:
    """Make the levels of these packages available, as long as the context lasts."""
    before = dict(_named)
    try:
        use_plugins(names)
        yield
    finally:
        _named.clear()
        _named.update(before)


def named_plugins() -> list[str]:
    """The plugins that the user named, to be passed on to other processes."""
    return list(_named)


def package_of(module: str) -> Package | None:
    """The package, ours or a plugin's, that a module belongs to; None for any other module."""
    for package in packages():
        if f"{module}.".startswith(f"{package.name}."):
            return package
    return None


def file_of(module: str) -> Path | None:
    """The file of a module of one of the packages; None for any other module, or without a file."""
    package = package_of(module)
    if package is None:
        return None
    inner = module.removeprefix(package.name).split(".")[1:]
    place = package.folder.joinpath(*inner)
    for path in (place.with_suffix(".py") if inner else place, place / "__init__.py"):
        if path.is_file():
            return path
    return None


_named: dict[str, Package] = {}
"""Plugins that the user named, by their names."""


@cache
def _installed() -> tuple[Package, ...]:
    """The plugins that distributions declare by an entry point."""
    points = entry_points(group=GROUP)
    return tuple(_plugin(name) for name in sorted({p.value.partition(":")[0] for p in points}))


def _plugin(name: str) -> Package:
    if not NAME.fullmatch(name) or name.partition(".")[0] == own().name:
        raise BadInput(f"plugin {name}: must be the name of another package, such as my_levels")
    folders = _folders_of(name)
    if not folders:
        raise BadInput(
            f"plugin {name}: there is no such package; install it, or put the folder that it lies "
            "in on PYTHONPATH"
        )
    for folder in folders:
        if (folder / "conf").is_dir():
            _check_rooms(name, folder / "conf")
            return Package(name, folder, folder / "conf")
    raise BadInput(f"plugin {name}: has no folder {folders[0] / 'conf'}, so it brings no levels")


def _folders_of(name: str) -> list[Path]:
    """The folders of a package, located without importing it or its parents."""
    first, *inner = name.split(".")
    try:
        spec = find_spec(first)
    except (ImportError, ValueError):
        return []
    places = (spec and spec.submodule_search_locations) or ()
    return [folder for place in places if (folder := Path(place).joinpath(*inner)).is_dir()]


def _check_rooms(name: str, conf: Path) -> None:
    rooms = {path.name for path in own().conf.iterdir() if path.is_dir()}
    for path in sorted(conf.iterdir()):
        if path.is_dir() and path.name[0] not in "._" and path.name not in rooms:
            valid = ", ".join(sorted(rooms))
            raise BadInput(f"plugin {name}: conf/{path.name} is no room; valid: {valid}")


@cache
def _disjoint(known: tuple[Package, ...]) -> tuple[Package, ...]:
    """The packages as they are. Raises BadInput where two have a level of one name."""
    owners: dict[str, str] = {}
    for package in known:
        for path in sorted(package.conf.glob("*/*.yaml")):
            level = path.relative_to(package.conf).as_posix()
            owner = owners.setdefault(level, package.name)
            if owner != package.name:
                raise BadInput(
                    f"plugin {package.name}: conf/{level} is a level of {owner} already; rename "
                    f"it, or leave {package.name} out"
                )
    return known
