"""The config of an earlier run, as the base of a new one.

A policy fits the config it was trained with: what is evaluated, watched or drawn starts from
that config, and settings may change the world around the policy but not its network.
"""

import difflib
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_type_hints

from omegaconf import MISSING, DictConfig

from marl_clean.config.class_source import constant, parameters
from marl_clean.config.compose import PERFECT, apply, check, checked, compose_parsed
from marl_clean.config.config_hash import config_hash
from marl_clean.config.hydra_adapter import Override
from marl_clean.config.levels import (
    PRESETS,
    conf_folder,
    is_target,
    level_of,
    read_level,
    rooms,
)
from marl_clean.config.locate import own
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.schema import mismatch
from marl_clean.config.sections import LaterEvaluation, Root
from marl_clean.errors import BadInput
from marl_clean.storage.manifest import weights_sha256
from marl_clean.storage.safe_yaml import load_yaml

log = logging.getLogger(__name__)
RUNS = Path("runs")
EVALUATED = "evaluate"  # in it: what `evaluate` measured
CONFIG, METRICS = "config.yaml", "metrics.csv"  # of a run's folder
LONGEST_PART, LONGEST_PATH = 255, 4000  # characters of a file's name and path
WEIGHTS = "weights"
NETWORK = ("observation", "encoder", "comm", "agent", "parameter_budget")
# Keys of these rooms that change no network: any weights run with them.
SAME_NETWORK = ("observation.position_noise", "agent.mask_walls", "agent.play")
BESIDE_THE_WEIGHTS = ("encoder.dropout", "encoder.channels_last")  # how they learn, or are stored


def compose_for_policy(overrides: Sequence[str]) -> DictConfig:
    """The config of `checkpoint`'s run with `overrides` on top; without one, the default config.

    Raises BadInput when there is no such run, its config is not one of ours, or an override
    would change the network whose weights it holds.
    """
    parsed = parse_overrides(overrides)
    run = _checkpoint_in(parsed)
    if run is None:
        return compose_parsed(parsed)
    for preset in (o.key for o in parsed if o.key in PRESETS):
        raise BadInput(f"{preset}: a checkpoint brings its own config; leave one of them out")
    stored = load_config(find_run(run))
    wanted = apply(stored, parsed)
    _check_fits(stored, wanted, run)
    return checked(wanted, parsed)


def compose_for_training(overrides: Sequence[str]) -> DictConfig:
    """What to train: the default config with `overrides`, or that of `checkpoint`'s run.

    The run is named by a setting, or by a preset. Its config is kept where presets and settings do
    not change it, and training starts from its weights, whose hash is written into the config so
    that other weights make another run. Settings of learning may change, those of the network may
    not.

    Raises BadInput as `compose_for_policy` does, and for a run that has no weights yet.
    """
    return parsed_for_training(parse_overrides(overrides))


def parsed_for_training(parsed: Sequence[Override]) -> DictConfig:
    """`compose_for_training` of settings that have been read already."""
    run = _checkpoint_in(parsed)
    if run is None:
        config = compose_parsed(parsed)
        if config.checkpoint is None:
            return config
        run = config.checkpoint
    folder = find_run(run)
    stored = load_config(folder)
    wanted = apply({**stored, "name": None, "logger": _plain_loggers(stored)}, parsed)
    _check_fits(stored, wanted, run, learning_may_change=True)
    start = {"checkpoint": str(folder), "weights": weights_sha256(folder)}
    return checked({**wanted, **start}, parsed)


def _plain_loggers(stored: dict[str, Any]) -> dict[str, Any]:
    """The loggers of a stored config with the settings of their yaml.

    Its own may name a server, which is to learn nothing of what is trained here.
    """
    loggers = stored["logger"] or {}
    levels = {name: level_of(section["_target_"]) for name, section in loggers.items()}
    return {name: read_level("logger", level) for name, level in levels.items()}


def _checkpoint_in(parsed: Sequence[Override]) -> str | None:
    """The run that the settings name, the last of several."""
    runs = [override.value for override in parsed if override.key == "checkpoint"]
    return None if not runs or runs[-1] is None else str(runs[-1])


def _check_fits(
    stored: dict[str, Any], wanted: dict[str, Any], run: str, learning_may_change: bool = False
) -> None:
    """Raises BadInput where the network of `wanted` is not that of the run's weights.

    A learner's class lists in `sized_by` which keys of the env its network depends on.
    """
    sized_by = constant(stored["agent"]["_target_"], "sized_by") or []
    for room in (*NETWORK, "env"):
        for key, old, new in differing(stored[room], wanted[room], room):
            if room == "env":
                matters = key in sized_by
            elif learning_may_change:
                of_learning = room == "agent" and key != "agent.dueling"
                matters = key not in (*SAME_NETWORK, *BESIDE_THE_WEIGHTS) and not of_learning
            else:
                matters = key not in SAME_NETWORK
            if matters:
                raise BadInput(
                    f"{key}: {new} does not fit checkpoint {run}, which was trained with {old}; "
                    "leave it out"
                )


def shipped_runs() -> dict[str, Path]:
    """The runs that ship with the package by name: in it (a wheel) or beside it (a checkout)."""
    package = own().folder
    for folder in (package / WEIGHTS, package.parent / WEIGHTS):
        if configs := sorted(folder.glob(f"*/{CONFIG}")):
            return {path.parent.name: path.parent for path in configs}
    return {}


def find_run(run: str) -> Path:
    """The folder of a run: a path, a name in runs/, or the name of one that ships.

    Raises BadInput without one.
    """
    if max(map(len, Path(run).parts), default=0) > LONGEST_PART or len(run) > LONGEST_PATH:
        raise BadInput(
            f"checkpoint={run[:40]}...: {len(run)} characters are no path; give the folder or the"
            " name of a run"
        )
    shipped = shipped_runs()
    for folder in (Path(run), RUNS / run, *([shipped[run]] if run in shipped else [])):
        if (folder / CONFIG).is_file():
            return folder
    if Path(run).exists():
        raise BadInput(f"checkpoint={run}: has no {CONFIG}; give the folder of a run")
    names = sorted({*(path.parent.name for path in RUNS.glob(f"*/{CONFIG}")), *shipped})
    close = difflib.get_close_matches(run, names, n=1)
    known = f"did you mean {close[0]}?" if close else f"runs: {', '.join(names[:9]) or 'none yet'}"
    raise BadInput(f"checkpoint={run}: there is no such run; {known}")


def load_config(folder: Path) -> dict[str, Any]:
    """The checked config of the run in `folder`; it may come from an untrusted source.

    Keys added after the run have the values of their level's yaml, which reproduce what was before
    there was a key. `out` is null: it said where that command wrote, not where another will.

    Raises BadInput when it is not a config of this package: other keys or types, classes from
    elsewhere, or `${...}` and `???`, which are no values (`${...}` could read this machine's
    environment).
    """
    path = folder / CONFIG
    plain = load_yaml(path)
    if not isinstance(plain, dict):
        raise BadInput(f"{path}: not the config of a run; it has no sections")
    if any("${" in text or text == MISSING for text in _texts(plain)):
        raise BadInput(
            f"{path}: holds ${{...}} or {MISSING}; the config of a run has its values written out"
        )
    try:
        plain = _completed(plain)
        check(plain)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    return {**plain, "out": None}


def _completed(plain: dict[str, Any]) -> dict[str, Any]:
    """The config with its missing optional keys: those with a default, or null at the root."""
    types = get_type_hints(Root, include_extras=True)
    whole = {**{key: None for key in types if mismatch(None, types[key]) is None}, **plain}
    whole = {"channel": PERFECT, **whole}
    evaluation = whole.get("evaluation")
    if isinstance(evaluation, dict):
        default = load_yaml(conf_folder() / "config.yaml")["evaluation"]
        whole["evaluation"] = {key: default[key] for key in get_type_hints(LaterEvaluation)}
        whole["evaluation"] |= evaluation
    for room in rooms():
        section = plain.get(room)
        if not isinstance(section, dict):
            continue
        target = str(section.get("_target_"))
        if is_target(room, target):
            level = read_level(room, level_of(target))
            accepted = parameters(target)
            optional = [name for name in accepted if name in level and not accepted[name].required]
            whole[room] = {**{name: level[name] for name in optional}, **section}
    return whole


def check_same_run(config: DictConfig, folder: Path, recorded: str | None = None) -> None:
    """Raises BadInput when `folder` holds a run of another config, naming a key that differs.

    `recorded`: the hash that the run's record holds, by which it is known too where its config
    is damaged, which is then said in one line.
    """
    if not (folder / CONFIG).is_file():
        return
    try:
        stored = load_config(folder)
    except BadInput as error:
        if recorded != config_hash(config):
            raise
        log.warning("%s; the run is known by its record, and its config written again", error)
        return
    if config_hash(DictConfig(stored)) == config_hash(config):
        return
    for room in map(str, config):
        for key, old, new in differing(stored.get(room), config[room], room):
            if key not in ("name", "out"):
                raise BadInput(
                    f"name={config.name}: {folder} holds a run with {key}={old}, not {new}; "
                    "choose another name"
                )


def differing(old: Any, new: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    """(key, old value, new value) of every leaf that is not the same."""
    if isinstance(old, dict) and isinstance(new, dict | DictConfig):
        for name in sorted({*old, *new}):
            yield from differing(old.get(name), new.get(name), f"{key}.{name}")
    elif old != new:
        yield key, old, new


def _texts(tree: Any) -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _texts(key)
            yield from _texts(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _texts(value)
    elif isinstance(tree, str):
        yield tree
