"""`marl_clean.study` and `marl_clean.tune`: many runs by one call, as the commands make them."""

import csv
import os
from collections.abc import Sequence
from typing import Any

from rich.console import Console

from marl_clean.commands import study as study_command
from marl_clean.commands import study_report
from marl_clean.commands import tune as tune_command
from marl_clean.commands._tune_settings import PREFIX, TuneSettings
from marl_clean.commands.verdicts import Verdict
from marl_clean.config.schema import choices
from marl_clean.errors import BadInput
from marl_clean.python.keywords import value_text

QUIET = Console(quiet=True)
TRIALS = "trials.csv"


def study(preset: str | os.PathLike[str], settings: Sequence[str] = (), /) -> list[Verdict]:
    """Run what a study lacks, write its page, and return of each rule whether it is met.

    As `marl-clean study` does, in `runs/studies/<name>`; the same call again does what is missing.
    `preset`: one with a section `study`, or a yaml file. `settings`: those of all arms, Hydra's own
    for launching, and `name=`. A verdict has `rule` (with `name`, `says`), `outcome` and what
    decided it.

    Raises:
        BadInput: what `marl-clean study` refuses, in the same words.
    """
    name = os.fspath(preset)
    study_command.main(name, settings, QUIET)
    return study_report.main(study_command.folder_of(name, settings), console=QUIET)


def tune(settings: Sequence[str], /, **keywords: Any) -> list[dict[str, Any]]:
    """Search keys of the config for the best value of a measure, and return the trials.

    As `marl-clean tune` does, in `runs/tune/<name>`; the same call again resumes. `settings` are
    those of the runs, in Hydra's grammar: `agent.lr=tag(log,interval(1e-4,1e-2))` is searched.
    Keywords are the command's own, without `tune.`: `trials=20`, `measure="T_90"`. A trial has
    `trial`, `state`, the measure (None without a value), each searched key as text, the names of
    its `runs`, and the `reason` of a failure. They are in the order of their numbers.

    Raises:
        BadInput: what `marl-clean tune` refuses, in the same words.
    """
    own = list(TuneSettings.__dataclass_fields__)
    for key in keywords:
        if key not in own:
            raise BadInput(f"tune: {key}: no such setting; {choices(key, own)}")
    texts = [f"{PREFIX}{key}={value_text(key, value)}" for key, value in keywords.items()]
    plan = tune_command.make_plan([*settings, *texts])
    tune_command.run([*settings, *texts], QUIET)
    with (plan.folder / TRIALS).open(newline="", encoding="utf-8") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    for row in rows:
        row["trial"] = int(row["trial"])
        row[plan.measure.name] = float(row[plan.measure.name]) if row[plan.measure.name] else None
        row["runs"] = row["runs"].split()
    return rows
