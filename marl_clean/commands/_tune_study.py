"""A search in Optuna: trials asked for, told and read, in `runs/tune/<name>/study.db`."""

import hashlib
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import SQLAlchemyError

from marl_clean.commands._space import Dimension
from marl_clean.commands._tune_settings import Direction
from marl_clean.config.hydra_adapter import first_line
from marl_clean.errors import BadInput
from marl_clean.storage.lock import Held, locked

DATABASE = "study.db"
IDENTITY = "searches"  # attribute of a study: what makes it another study
OPENING_TRIES, OPENING_PAUSE_SECONDS = 60, 0.5
ENDED = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
OF_STORAGE: tuple[type[Exception], ...] = (SQLAlchemyError, optuna.exceptions.OptunaError, OSError)


class Study:
    """Trials of one search, shared with other processes that do the same.

    Args:
        folder: of its database; made if need be.
        identity: what is searched and how it is measured, by name.
        dimensions: the searched keys.
        direction: minimize or maximize.
        seed: of the sampler. What it draws depends on it, the trial's number and the trials before
            alone, so that an interrupted search goes on as it would have.
        pruner: stops trials.

    Raises:
        BadInput: the database is damaged, cannot be written, or holds another search.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, str],
        dimensions: tuple[Dimension, ...],
        direction: Direction,
        seed: int,
        pruner: optuna.pruners.BasePruner,
    ) -> None:
        self.path, self.dimensions, self.seed = folder / DATABASE, dimensions, seed
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"{folder} cannot be made: {error.strerror}") from None
        with opening(folder), self.readable((Exception,)):  # Alembic raises what it likes
            self.study = optuna.create_study(
                storage=f"sqlite:///{self.path}",
                study_name="tune",
                direction=direction,
                load_if_exists=True,
                pruner=pruner,
            )
            stored = self.study.user_attrs.get(IDENTITY)
            if stored is None:
                self.study.set_user_attr(IDENTITY, stored := dict(identity))
        for name, value in identity.items():
            if stored.get(name) != value:
                raise BadInput(
                    f"tune.name: {folder} holds a search with another {name}:"
                    f" {stored.get(name)}, not {value}; choose another name"
                )

    @contextmanager
    def readable(self, errors: tuple[type[Exception], ...] = OF_STORAGE) -> Iterator[None]:
        """Raises BadInput where the database fails."""
        try:
            yield
        except errors as error:
            cause = error.__cause__ if isinstance(error.__cause__, Exception) else error
            raise BadInput(
                f"{self.path}: is damaged, or no database of Optuna's: {first_line(cause)}; move"
                " it away, or choose another tune.name"
            ) from error

    def trials(self) -> list[FrozenTrial]:
        """All trials that have begun, by their number."""
        with self.readable((Exception,)):  # of what a damaged row is read to be
            states = (*ENDED, TrialState.RUNNING)
            return self.study.get_trials(deepcopy=False, states=states)

    def next_trial(self, total: int, without: set[int]) -> int | None:
        """The number of a trial to work on: one that was left, or a new one; None at `total`."""
        trials = self.trials()
        for trial in trials:
            if trial.state is TrialState.RUNNING and trial.number not in without:
                return trial.number
        if len(trials) >= total:
            return None
        with self.readable():
            self._draw_for(len(trials))
            return self.study.ask().number

    def open_trial(self, number: int) -> "OpenTrial | None":
        """The trial with its values; None where another process has ended it."""
        [frozen] = [trial for trial in self.trials() if trial.number == number]
        if frozen.state is not TrialState.RUNNING:
            return None
        with self.readable():
            self._draw_for(number)
            trial = optuna.trial.Trial(self.study, frozen._trial_id)
            values = {d.key: _suggest(trial, d) for d in self.dimensions}
        return OpenTrial(self, trial, values, set(frozen.intermediate_values))

    def _draw_for(self, number: int) -> None:
        digest = hashlib.sha256(f"{self.seed} {number}".encode()).digest()
        seed = int.from_bytes(digest[:4], "big")
        self.study.sampler = optuna.samplers.TPESampler(seed=seed)

    def text_of(self, trial: FrozenTrial, key: str) -> str:
        """The value of a searched key in a trial, as typed; empty before it was drawn."""
        if key not in trial.params:
            return ""
        [dimension] = [d for d in self.dimensions if d.key == key]
        return _text(dimension, trial.params[key])


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder that has nothing else in it. Raises Held as `locked` does."""
    try:
        with locked(folder):
            yield
    finally:
        with suppress(OSError):
            folder.rmdir()  # which another process may have made


@contextmanager
def opening(folder: Path) -> Iterator[None]:
    """Wait until no other process opens the database: two that make its tables at once fail."""
    for attempt in range(OPENING_TRIES):
        try:
            with alone(folder / "opening"):
                yield
                return
        except Held:
            if attempt + 1 == OPENING_TRIES:
                raise
            time.sleep(OPENING_PAUSE_SECONDS)


class OpenTrial:
    """A trial that is worked on: its values, and what is told of it.

    Attributes:
        values: of the searched keys, as typed.
        told: the steps of which it has an intermediate value.
    """

    def __init__(
        self, study: Study, trial: optuna.trial.Trial, values: dict[str, str], told: set[int]
    ) -> None:
        self.study, self.trial, self.values, self.told = study, trial, values, told
        self.number = trial.number

    def note(self, key: str, value: Any) -> None:
        """Keep something about the trial."""
        with self.study.readable():
            self.trial.set_user_attr(key, value)

    def noted(self, key: str) -> Any:
        """What was kept; None without it."""
        return self.trial.user_attrs.get(key)

    def report(self, step: int, value: float) -> None:
        """Tell an intermediate value, once a step."""
        if step in self.told:
            return
        self.told.add(step)
        with self.study.readable():
            self.trial.report(value, step)

    def should_stop(self) -> bool:
        """Whether the pruner gives the trial up."""
        with self.study.readable():
            return bool(self.trial.should_prune())  # NumPy's own

    def complete(self, value: float) -> None:
        """Tell the trial's value."""
        with self.study.readable():
            self.study.study.tell(self.trial, value)

    def pruned(self) -> None:
        """Tell that the trial was given up."""
        with self.study.readable():
            self.study.study.tell(self.trial, state=TrialState.PRUNED)

    def fail(self, reason: str) -> None:
        """Tell that the trial has no value, and why, in one line."""
        self.note("reason", " ".join(reason.split()))
        with self.study.readable():
            self.study.study.tell(self.trial, state=TrialState.FAIL)


def pruner_of(name: str, prune_after: int) -> optuna.pruners.BasePruner:
    """The pruner `median` or `none`."""
    if name == "none":
        return optuna.pruners.NopPruner()
    return optuna.pruners.MedianPruner(n_startup_trials=prune_after)


def _suggest(trial: optuna.trial.Trial, dimension: Dimension) -> str:
    """The trial's value of a key: the stored one of a trial that was left, else a new one."""
    key, low, high, log = dimension.key, dimension.low, dimension.high, dimension.log
    if low is None or high is None:
        return str(trial.suggest_categorical(key, dimension.texts))
    if dimension.whole:
        step = int(dimension.step or 1)
        return _text(dimension, trial.suggest_int(key, int(low), int(high), step=step, log=log))
    return _text(dimension, trial.suggest_float(key, low, high, step=dimension.step, log=log))


def _text(dimension: Dimension, value: Any) -> str:
    return str(value) if dimension.low is None else dimension.text_of(value)
