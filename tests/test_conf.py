"""The house rules that hold the listings together: conf/ and rooms, imports and floors."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path

import pytest
import yaml

from marl_clean.config import class_source, compose, levels
from tests.families import family

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "marl_clean"
CONF = ROOT / "conf"
PRESETS = sorted(path for group in levels.PRESETS for path in CONF.glob(f"{group}/*.yaml"))
SHARED = sorted(CONF.glob("*/_*.yaml"))  # by levels of a room, and none themselves
LEVELS = sorted(set(CONF.glob("*/*.yaml")) - {*PRESETS, *SHARED})

# Rooms that hold nothing but levels; env/ is a workroom that has one.
ROOMS = sorted({path.parent.name for path in LEVELS} - {"env"})

# What code hands to a constructor although yaml could say it.
HANDED_OVER = {"house_order", "first_env", "seed", "device"}

# From the bottom to the top: what a module imports lies on a floor below it, or in its own room.
# What no floor names is on top: the commands, and what Python and PettingZoo users import.
FLOORS = [
    {"errors", "keys", "settings"},
    {"storage"},
    {"config"},
    {"world"},
    {"house"},
    {"env"},
    {"observation", "topology", "reward", "encoder", "comm", "channel"},
    {"learning"},
    {"agent", "planner"},
    {"build"},
    {"trainer", "evaluation", "report", "logger"},
]
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names}
TOP = len(FLOORS)
ALONE = FLOOR["observation"]  # the floor whose rooms do not know each other
MODULES = sorted(PACKAGE.rglob("*.py"))


@cache
def imports(source: Path) -> list[str]:
    """The full names of what a file imports, inside functions too."""
    dotted = []
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            dotted += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            dotted += [f"{node.module}.{alias.name}" for alias in node.names]
    return dotted


def floor_and_room(dotted: str) -> tuple[int, str]:
    """The floor of `marl_clean.<room>...`; what no floor lists belongs to the commands."""
    room = dotted.split(".")[1]
    return FLOOR.get(room, TOP), room


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", LEVELS, ids=name_of)
def test_a_yaml_belongs_to_the_file_of_its_name(path: Path) -> None:
    section = yaml.safe_load(path.read_text())
    assert section["_target_"].startswith(f"marl_clean.{path.parent.name}.{path.stem}.")
    assert class_source.definition(section["_target_"])


@pytest.mark.parametrize("room", ROOMS)
def test_a_level_has_a_yaml(room: str) -> None:
    files = {path.stem for path in (PACKAGE / room).glob("*.py")} - {"base"}
    files = {name for name in files if not name.startswith("_")}
    assert files == {path.stem for path in (CONF / room).glob("[!_]*.yaml")}


@pytest.mark.parametrize("path", LEVELS, ids=name_of)
def test_keys_are_the_parameters_of_the_constructor(path: Path) -> None:
    section = levels.read_level(path.parent.name, path.stem)
    accepted = set(class_source.parameters(section["_target_"]))
    assert set(section) - {"_target_"} == accepted - HANDED_OVER


@cache
def level_class(path: Path) -> type:
    module, _, name = yaml.safe_load(path.read_text())["_target_"].rpartition(".")
    return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("path", LEVELS, ids=name_of)
def test_a_level_is_final_and_no_other_levels_base(path: Path) -> None:
    level = level_class(path)
    assert "__final__" in vars(level), f"{level.__name__} is not typing.final"
    others = {other for other in map(level_class, LEVELS) if other is not level}
    assert others.isdisjoint(level.__mro__)


@pytest.mark.parametrize("path", [*LEVELS, *SHARED, CONF / "config.yaml"], ids=name_of)
def test_every_key_is_explained(path: Path) -> None:
    ours = path.read_text().splitlines()
    keys = [line for line in ours if re.match(r"\s*(- )?\w+: \S", line)]
    assert [key for key in keys if " # " not in key and "_target_" not in key] == []


@family("path", sorted(CONF.glob("experiment/*.yaml")), fast=4, usual=12, ids=name_of)
def test_a_preset_composes_and_names_its_runs(path: Path) -> None:
    assert compose.compose_config([f"+experiment={path.stem}"]).name.startswith(f"{path.stem}-")


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(CONF.glob("budget/*.yaml")), ids=name_of)
def test_a_budget_has_the_last_word_over_a_preset(path: Path) -> None:
    frames = yaml.safe_load(path.read_text())["trainer"]["total_frames"]
    config = compose.compose_config(["experiment=quick", f"budget={path.stem}"])
    assert config.trainer.total_frames == frames
    assert config.name.startswith("quick-")


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_go_down_only(path: Path) -> None:
    own, own_room = floor_and_room(".".join(path.relative_to(ROOT).with_suffix("").parts))
    for dotted in imports(path):
        if dotted.startswith("marl_clean.") and own < TOP:
            floor, room = floor_and_room(dotted)
            assert floor <= own, f"{dotted} is a floor above {own_room}"
            assert floor < own or own != ALONE or room == own_room, f"{dotted} is another room"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_the_lower_floors_need_few_libraries(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    barred = {
        "house": {"torch", "torchrl", "tensordict"},
        "world": {"torchrl", "tensordict"},
        "encoder": {"torchrl", "tensordict"},
        "comm": {"torchrl", "tensordict"},
        "config": {"torch", "torchrl", "tensordict"},
    }.get(room, set())
    used = {dotted.partition(".")[0] for dotted in imports(path)}
    assert used & (barred | {"pickle", "shelve", "marshal"}) == set()


@pytest.mark.parametrize("path", sorted((PACKAGE / "encoder").glob("*.py")), ids=name_of)
def test_encoders_can_be_used_on_their_own(path: Path) -> None:
    rooms = {d.split(".")[1] for d in imports(path) if d.startswith("marl_clean.")}
    assert rooms <= {"encoder", "errors", "settings"}


def test_the_floor_rule_sees_an_import_upwards(tmp_path: Path) -> None:
    source = tmp_path / "up.py"
    source.write_text("def f():\n    from marl_clean.trainer import off_policy\n")
    assert [floor_and_room(dotted) for dotted in imports(source)] == [(TOP - 1, "trainer")]


def test_the_defaults_name_every_room() -> None:
    sections = {key for key, value in compose.compose_config().items() if hasattr(value, "keys")}
    assert sections == {*levels.rooms(), "evaluation"}
