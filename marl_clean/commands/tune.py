"""`marl-clean tune`: searches any keys of the config for the best value of a measure, by Optuna.

Trials are asked for and told one by one. The search is a database, each run is a folder named by
its config's hash: so the same command goes on where another has stopped, and no config is trained
twice. Several processes may work at one search.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from marl_clean.commands._space import Space, read_space
from marl_clean.commands._tune_settings import (
    PREFIX,
    Measure,
    TuneSettings,
    measure_of,
    read_settings,
)
from marl_clean.commands.checks import check_all, check_no_study
from marl_clean.config.config_hash import config_hash
from marl_clean.config.installed import is_installed
from marl_clean.config.levels import EXPERIMENT
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput
from marl_clean.evaluation.table import output

FOLDER = "tune"


@dataclass(frozen=True)
class Plan:
    """A search, all of whose input has been checked.

    Attributes:
        identity: what makes it another search, by name.
        folder: of its database and its table.
    """

    settings: TuneSettings
    space: Space
    measure: Measure
    identity: dict[str, str]
    folder: Path


def make_plan(texts: Sequence[str]) -> Plan:
    """The search that a command's settings describe. Raises BadInput before anything is made."""
    settings = read_settings([text for text in texts if text.startswith(PREFIX)])
    of_runs = [text for text in texts if not text.startswith(PREFIX)]
    check_no_study(of_runs)
    space = read_space(of_runs)
    config = space.config(space.first())
    measure = measure_of(settings, config)
    check_all(config, training=True)
    if settings.seeds > 1 and any(d.key == "seed" for d in space.dimensions):
        raise BadInput(f"{PREFIX}seeds={settings.seeds}: seed is searched itself; leave one out")
    identity = {
        "space": "; ".join(f"{dimension.key}: {dimension}" for dimension in space.dimensions),
        "fixed config": config_hash(config)[:16],
        "measure": f"{measure.name}, {measure.direction}",
        "number of seeds": str(settings.seeds),
        "sampler's seed": str(settings.seed),
    }
    name = settings.name
    if name is None:
        presets = [o.value for o in space.settings if o.key == EXPERIMENT]
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        name = f"{(presets and presets[-1]) or 'run'}-{digest[:8]}"
    return Plan(settings, space, measure, identity, RUNS / FOLDER / name)


def run(texts: Sequence[str], console: Console | None = None) -> int:
    """Do what is missing of a search, and print its table; 0 where a trial is complete, else 1.

    Raises:
        BadInput: a setting is refused, Optuna is missing, or the search's database is unusable.
        SystemExit, KeyboardInterrupt: after a signal; the same command goes on.
    """
    plan = make_plan(texts)
    if not is_installed("optuna"):
        raise BadInput("tune: Optuna is not installed; pip install 'marl-clean[tune]'")
    from marl_clean.commands._search import search

    return search(plan, console or output())
