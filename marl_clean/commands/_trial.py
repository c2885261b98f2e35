"""One trial of a search: runs of its settings, one a seed, trained as `marl-clean train` does.

A run is trained and not yet measured: test houses are for what the search has chosen. `marl-clean
train` with the same settings finds it trained, measures it and draws.
"""

import csv
import math
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from marl_clean.commands._job import KILLED, MOST_DEATHS, note_failure
from marl_clean.commands._space import Space
from marl_clean.commands._tune_settings import MINIMISE, VALIDATION, Measure
from marl_clean.commands._tune_study import OpenTrial
from marl_clean.commands.checks import check_all
from marl_clean.commands.run_info import FAILED, LOG, last_frames
from marl_clean.config.stored import METRICS, RUNS
from marl_clean.errors import BadInput
from marl_clean.logger.base import Logger
from marl_clean.storage.lock import Held, locked


class Pruned(Exception):
    """The pruner has given the trial up."""


@dataclass(frozen=True)
class Ended:
    """What became of a trial: its value, or why it has none."""

    value: float | None
    reason: str = ""
    pruned: bool = False


class Report(Logger):
    """Tells a trial what its run measures on validation houses, and stops the run by Pruned.

    Nothing is saved for it: the run resumes from its last state, if ever.

    Args:
        trial: that is told.
        column: of a row of metrics.csv.
        interval_frames: between evaluations; the trial's steps are counted in it.
        stops: frames between which the run may be stopped, the second excluded.
    """

    def __init__(
        self, trial: OpenTrial, column: str, interval_frames: int, stops: tuple[float, float]
    ) -> None:
        self.trial, self.column = trial, column
        self.interval_frames, self.stops = interval_frames, stops

    def resume(self, frames: int) -> None:
        """What an earlier process has told stands: a resumed run measures the same."""

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        evaluated = any(name.startswith(VALIDATION) for name in values)
        value = values.get(self.column)
        if not evaluated or value is None or not math.isfinite(value):
            return
        self.trial.report(frames // self.interval_frames, float(value))
        first, end = self.stops
        if first <= frames < end and self.trial.should_stop():
            raise Pruned

    def close(self) -> None:
        """Everything is told at once."""


def run_trial(
    trial: OpenTrial, space: Space, measure: Measure, seeds: int, prune_from: float
) -> Ended:
    """Train what is missing of a trial's runs, and tell the trial its value or its failure.

    `prune_from`: share of a run's frames before which it is not stopped.

    Raises:
        Held: another process trains one of the runs; the trial is left as it is.
        SystemExit, KeyboardInterrupt: after a signal, when the run's state is saved.
    """
    values = []
    try:
        first = space.config(trial.values)
        named = [first]
        named += [space.config(trial.values, seed=first.seed + i) for i in range(1, seeds)]
        trial.note("runs", [config.name for config in named])
        for number, config in enumerate(named):
            check_all(config, training=True)
            total = config.trainer.total_frames
            interval = config.trainer.eval_interval_frames
            stops = (prune_from * total, float(total))
            report = Report(trial, measure.column, interval, stops)
            values.append(_value_of(trial, config, measure, report if number == 0 else None))
    except Held:
        raise
    except Pruned:
        trial.pruned()
        return Ended(None, pruned=True)
    except BadInput as error:
        return _failed(trial, str(error))
    except Exception as error:  # whatever training raises is the trial's end, not the search's
        return _failed(trial, f"{type(error).__name__}: {error}")
    value = sum(values) / len(values)
    trial.complete(value)
    return Ended(value)


def _failed(trial: OpenTrial, reason: str) -> Ended:
    trial.fail(reason)
    return Ended(None, " ".join(reason.split()))


def _value_of(
    trial: OpenTrial, config: DictConfig, measure: Measure, report: Report | None
) -> float:
    """Train a run, or what is left of it, and return its measure."""
    from marl_clean.commands import train
    from marl_clean.commands.run_record import recorded

    folder = RUNS / config.name
    with locked(folder):
        _check_deaths(trial, folder)
        (folder / FAILED).unlink(missing_ok=True)
        try:
            with recorded(config, folder) as begin:
                train.train(config, folder, begin, [] if report is None else [report])
        except (Pruned, Held):
            raise
        except (SystemExit, KeyboardInterrupt):
            trial.note("begun", None)  # this is no death
            raise
        except Exception as error:
            _note_failure(folder, error, trial)
            raise
        if report is not None:
            _report_logged(folder, report)
        return logged_value(folder, measure)


def _check_deaths(trial: OpenTrial, folder: Path) -> None:
    """Note that work begins. Raises BadInput where that has led nowhere too often."""
    frames = last_frames(folder)
    before = trial.noted("begun")
    times = before["times"] + 1 if before and before["at"] == [folder.name, frames] else 1
    if times > MOST_DEATHS:
        raise BadInput(KILLED)
    trial.note("begun", {"at": [folder.name, frames], "times": times})


def _note_failure(folder: Path, error: Exception, trial: OpenTrial) -> None:
    """Leave what a failed job of a sweep leaves: failed.txt, and the traceback in the log."""
    reason = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOG).open("a", encoding="utf-8") as log:
        begins = log.tell()
        traceback.print_exception(error, file=log)
    settings = [f"{key}={value}" for key, value in trial.values.items()]
    note_failure(folder, reason, settings, begins)


def _report_logged(folder: Path, report: Report) -> None:
    """Tell the trial what an earlier process logged of a run that was finished before."""
    for row in _rows(folder):
        numbers = {name: float(text) for name, text in row.items() if name and text}
        try:
            report.log(int(numbers["frames"]), numbers)
        except Pruned:  # it is finished already
            continue


def logged_value(folder: Path, measure: Measure) -> float:
    """A run's value by its metrics.csv: the best evaluation, or the last of another column.

    Raises BadInput where it has none.
    """
    values = [float(row[measure.column]) for row in _rows(folder) if row.get(measure.column)]
    values = [value for value in values if math.isfinite(value)]
    if not values:
        raise BadInput(f"tune.measure={measure.name}: {folder / METRICS} has no value of it")
    best = min if measure.direction == MINIMISE else max
    return best(values) if measure.of_validation else values[-1]


def _rows(folder: Path) -> list[dict[str, str]]:
    """The rows of metrics.csv; none where it cannot be read."""
    try:
        with (folder / METRICS).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return [row for row in rows if None not in row.values() and None not in row]
    except (OSError, ValueError, csv.Error):
        return []
