"""Where levels come from: the packages whose modules a `_target_` may name."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from marl_clean.errors import BadInput


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
    """Every package whose levels may be taken, this one first."""
    return (own(),)


def file_of(module: str) -> Path | None:
    """The file of a module of one of the packages; None of anybody else's, or of none at all.

    Nothing is imported for it: the names of folders and files are all that is looked at.
    """
    name, *inner = module.split(".")
    for package in packages():
        if package.name == name:
            place = package.folder.joinpath(*inner)
            for path in (place.with_suffix(".py") if inner else place, place / "__init__.py"):
                if path.is_file():
                    return path
    return None
