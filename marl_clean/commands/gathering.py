"""What finished runs measured, world by world: settings with their seeds, and planners."""

import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from marl_clean.commands.labels import labels, level_of
from marl_clean.config.class_source import constant
from marl_clean.config.config_hash import OUTSIDE_THE_HASH
from marl_clean.config.schema import choices
from marl_clean.config.stored import find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.marl_eval import read_marl_eval
from marl_clean.evaluation.measured import Measured
from marl_clean.evaluation.paired import Row
from marl_clean.evaluation.records import MEASURED, Entry, read_entries
from marl_clean.evaluation.tidy import read_tidy
from marl_clean.storage.manifest import count_weights

IGNORED_KEYS = (*OUTSIDE_THE_HASH, "seed")  # runs of one setting may differ in these
SPEED_KEYS = ("num_envs", "compile")  # of the env: they change its speed, not its rules
log = logging.getLogger(__name__)

Config = Mapping[str, Any]


@dataclass
class Setting:
    """Runs of one config in one world, by their seed.

    `label` is its name: of an export, which has no config, or the arm of a study.
    """

    config: Config | None
    silent: bool
    label: str | None = None
    runs: dict[int, Entry] = field(default_factory=dict)
    folders: dict[int, Path] = field(default_factory=dict)
    parameters: int | None = None


@dataclass
class World:
    """What was measured in one world on the same houses: settings of learners, and planners."""

    settings: dict[str, Setting] = field(default_factory=dict)
    planners: dict[str, Entry] = field(default_factory=dict)


def gather(runs: Sequence[str]) -> dict[str, World]:
    """What finished runs and exports measured, by a hash of the world; others are logged."""
    worlds: dict[str, World] = {}
    seen: set[Path] = set()
    for run in runs:
        try:
            path = Path(run) if Path(run).is_file() else find_run(run)
            measured = read_export(path) if path.is_file() else of_folder(path)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        if path.resolve() in seen:
            continue
        seen.add(path.resolve())
        for item in measured:
            _add(worlds.setdefault(item.world, World()), item)
    return worlds


def _add(world: World, item: Measured) -> None:
    """Put an entry into its world, in place."""
    if item.setting is None or item.seed is None:  # a planner acts alike in one world
        world.planners[item.entry["policy"]] = item.entry
        return
    new = Setting(item.config, item.silent, item.label)
    setting = world.settings.setdefault(item.setting, new)
    setting.runs[item.seed] = item.entry
    setting.parameters = item.parameters
    if item.folder is not None:
        setting.folders[item.seed] = item.folder


def read_export(path: Path) -> list[Measured]:
    """What a file of `compare --export` holds. Raises BadInput where it is none."""
    readers = {".csv": read_tidy, ".json": read_marl_eval}
    if path.suffix not in readers:
        raise BadInput(f"{path}: is no run's folder and no export; marl_eval.json and tidy.csv are")
    return readers[path.suffix](path)


def of_folder(folder: Path) -> list[Measured]:
    """What a run's evaluation.json holds. Raises BadInput where the run is not finished."""
    config = load_config(folder)
    entries = read_entries(folder / MEASURED)
    if config["name"] not in {entry["policy"] for entry in entries}:
        raise BadInput(f"{folder / MEASURED}: has no entry of its own run")
    result = []
    for entry in entries:
        if "change" in entry:  # an intervention, which is neither a run nor a planner
            continue
        world = hash_of(world_key(entry, config["env"]))
        if entry["policy"] != config["name"]:
            result.append(Measured(world, None, None, entry, entry["policy"]))
            continue
        run = Measured(
            world,
            hash_of(_setting_key(config)),
            config["seed"],
            entry,
            silent=level_of(config["comm"]) == "none",
            parameters=count_weights(folder),
            config=config,
            folder=folder,
        )
        result.append(run)
    return result


def measured_of(key: str, world: World, rows: Sequence[Row]) -> list[Measured]:
    """A world as an export writes it: every run under its row's label, planners last."""
    result = [
        Measured(
            key,
            setting_key,
            seed,
            entry,
            row.label,
            setting.silent,
            setting.parameters,
            folder=setting.folders.get(seed),
        )
        for row, (setting_key, setting) in zip(rows, world.settings.items(), strict=True)
        for seed, entry in setting.runs.items()
    ]
    planners = world.planners.items()
    return result + [Measured(key, None, None, entry, name) for name, entry in planners]


def rows_of(world: World) -> list[Row]:
    """One row per setting, by its label, or labelled by what sets it apart."""
    settings = list(world.settings.values())
    unnamed = [setting for setting in settings if setting.label is None]
    configs = [setting.config for setting in unnamed if setting.config is not None]
    if len(configs) == 1:
        [entries] = [setting.runs.values() for setting in unnamed]
        fresh = iter([common_prefix([entry["policy"] for entry in entries])])
    else:
        fresh = iter(labels(configs, IGNORED_KEYS))
    rows: dict[str, Row] = {}
    for setting in settings:
        label = next(fresh) if setting.label is None else setting.label
        if label in rows:  # of an export beside folders
            label = f"{label} [{len(rows) + 1}]"
        rows[label] = Row(label, dict(setting.runs), setting.parameters)
    return list(rows.values())


def reference_of(world: World, rows: Sequence[Row], against: str | None) -> Row:
    """The row that the others are compared with: `against`, else one without communication.

    Without either it is the first.

    Raises BadInput where no row is labelled `against`.
    """
    if against is not None:
        by_label = {row.label: row for row in (*rows, *planners_of(world))}
        if against not in by_label:
            raise BadInput(f"--against {against}: no such row; {choices(against, by_label)}")
        return by_label[against]
    silent = [
        row for row, setting in zip(rows, world.settings.values(), strict=True) if setting.silent
    ]
    return silent[0] if silent else rows[0]


def engineered_of(world: World, rows: Sequence[Row]) -> list[str]:
    """The labels of rows whose messages are parts of maps or entries of the env, not learnt."""
    return [
        row.label
        for row, setting in zip(rows, world.settings.values(), strict=True)
        if setting.config is not None and constant(setting.config["comm"]["_target_"], "engineered")
    ]


def planners_of(world: World) -> list[Row]:
    """One row per planner."""
    return [Row(name, {None: entry}) for name, entry in world.planners.items()]


def world_key(entry: Entry, env: Mapping[str, Any]) -> str:
    """A text that comparable entries share: the world's rules, and the same houses and starts."""
    ignored = (*SPEED_KEYS, "n_agents")  # an entry may be of another team size than training
    rules = {key: value for key, value in env.items() if key not in ignored}
    names = ("seed", "path", "rows", "cols", "free_cells", "bound_100", "max_steps")
    houses = [[house.get(name) for name in names] for house in entry["houses"]]
    return json.dumps([rules, entry["house_set"], entry["n_agents"], houses], sort_keys=True)


def hash_of(key: str) -> str:
    """A short name of a long text."""
    return hashlib.sha256(key.encode()).hexdigest()[:16]


def _setting_key(config: Config) -> str:
    """A text that runs share which differ in their seeds alone: the rest of their config."""
    setting = {key: value for key, value in config.items() if key not in IGNORED_KEYS}
    return json.dumps(setting, sort_keys=True)


def common_prefix(names: Sequence[str]) -> str:
    """The common prefix of names, without the separators at its end."""
    shortest, longest = min(names), max(names)
    length = next((i for i, c in enumerate(shortest) if c != longest[i : i + 1]), len(shortest))
    return shortest[:length].removesuffix("s").rstrip("-_") or shortest
