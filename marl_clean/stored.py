"""The config of an earlier run, as the base of a new one.

A policy fits the config it was trained with: what is evaluated, watched or drawn starts from
that config, and settings may change the world around the policy but not its network.
"""

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from marl_clean.compose import (
    PRESETS,
    apply,
    checked,
    compose_config,
    config_hash,
    parse_overrides,
)
from marl_clean.errors import BadInput
from marl_clean.safe_yaml import load_yaml

RUNS = Path("runs")
CONFIG = "config.yaml"
NETWORK = ("observation", "encoder", "comm", "agent")
SAME_NETWORK = ("observation.position_noise",)  # of these rooms, but any weights play with it


def compose_for_policy(overrides: Sequence[str]) -> DictConfig:
    """The config of `checkpoint`'s run with `overrides` on top; without one, the default's.

    Raises BadInput when there is no such run, its config is not one of ours, or an override
    would change the network whose weights it holds.
    """
    parsed = parse_overrides(overrides)
    given = [override.value() for override in parsed if override.key_or_group == "checkpoint"]
    if not given or given[-1] is None:
        return compose_config(overrides)
    for preset in (o.key_or_group for o in parsed if o.key_or_group in PRESETS):
        raise BadInput(f"{preset}: a checkpoint brings its own config; leave one of them out")
    stored = load_config(find_run(str(given[-1])))
    wanted = apply(stored, parsed)
    for room in NETWORK:
        for key, old, new in _differences(stored[room], wanted[room], room):
            if key not in SAME_NETWORK:
                raise BadInput(
                    f"{key}: {new} does not fit checkpoint {given[-1]}, which was trained with"
                    f" {old}; leave it out"
                )
    return checked(wanted, parsed)


def find_run(run: str) -> Path:
    """The folder of a run, given as a path or as a name in runs/. Raises BadInput without one."""
    for folder in (Path(run), RUNS / run):
        if (folder / CONFIG).is_file():
            return folder
    if Path(run).exists():
        raise BadInput(f"checkpoint={run}: has no {CONFIG}; give the folder of a run")
    names = sorted(path.parent.name for path in RUNS.glob(f"*/{CONFIG}"))
    close = difflib.get_close_matches(run, names, n=1)
    known = f"did you mean {close[0]}?" if close else f"runs: {', '.join(names[:9]) or 'none yet'}"
    raise BadInput(f"checkpoint={run}: there is no such run; {known}")


def load_config(folder: Path) -> dict[str, Any]:
    """The checked config of the run in `folder`; it may come from a stranger.

    Raises BadInput when it is not a config of this package: other keys or types, classes from
    elsewhere, or `${...}`, which could read this machine's environment.
    """
    path = folder / CONFIG
    plain = load_yaml(path)
    if not isinstance(plain, dict) or not all(isinstance(key, str) for key in plain):
        raise BadInput(f"{path}: not the config of a run; it has no sections")
    if any("${" in text for text in _texts(plain)):
        raise BadInput(f"{path}: holds ${{...}}; the config of a run has its values written out")
    try:
        checked(plain)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    return plain


def check_same_run(config: DictConfig, folder: Path) -> None:
    """Raises BadInput when `folder` holds a run of another config, naming a key that differs."""
    if not (folder / CONFIG).is_file():
        return
    stored = load_config(folder)
    mine = {str(key): value for key, value in config.items()}
    if config_hash(DictConfig(stored)) == config_hash(config):
        return
    for room in mine:
        for key, old, new in _differences(stored.get(room), config[room], room):
            if key != "name":
                raise BadInput(
                    f"name={config.name}: {folder} holds a run with {key}={old}, not {new}; "
                    "choose another name"
                )


def _differences(old: Any, new: Any, key: str) -> Iterator[tuple[str, Any, Any]]:
    """(key, old value, new value) of every leaf that is not the same."""
    if isinstance(old, dict) and isinstance(new, dict | DictConfig):
        for name in sorted({*old, *new}):
            yield from _differences(old.get(name), new.get(name), f"{key}.{name}")
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
