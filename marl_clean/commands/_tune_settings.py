"""The settings of `marl-clean tune` itself, `tune.KEY=VALUE`, and what it may measure trials by."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Literal, get_type_hints

from omegaconf import DictConfig
from pydantic import Field

from marl_clean.config.compose import has_houses
from marl_clean.config.locate import packages
from marl_clean.config.overrides import check_single_values, parse_overrides
from marl_clean.config.schema import choices, convert, problems_of_mapping
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import MEASURES
from marl_clean.settings import FolderName, PositiveInt, Probability, Seed

PREFIX = "tune."
VALIDATION = "validation/"  # of the columns of metrics.csv that are means over validation houses
Direction = Literal["minimize", "maximize"]  # Optuna's words
MINIMISE: Direction = "minimize"
MAXIMISE: Direction = "maximize"


@dataclass(frozen=True)
class TuneSettings:
    """What a search does, whatever is searched.

    Attributes:
        trials: number of trials, those of earlier calls included.
        measure: a mean over validation houses, such as T_90, or a column of metrics.csv; None:
            trainer.select_by.
        direction: minimize or maximize; None: known from the measure.
        seeds: runs a trial, of consecutive seeds; its value is their mean.
        seed: of the sampler.
        pruner: median stops a run that is worse than the median at the same share of training.
        prune_after: finished trials before any is stopped.
        prune_from: share of a run's frames before which it is not stopped: first evaluations say
            little.
        name: of the folder runs/tune/<name>; None: the preset, and a hash of what is searched.
    """

    trials: Annotated[int, Field(ge=1, le=100_000)] = 20
    measure: str | None = None
    direction: Direction | None = None
    seeds: Annotated[int, Field(ge=1, le=1000)] = 1
    seed: Seed = 0
    pruner: Literal["median", "none"] = "median"
    prune_after: PositiveInt = 5
    prune_from: Probability = 0.25
    name: FolderName | None = None


def described() -> str:
    """Every setting with its default, for the help."""
    return ", ".join(
        f"{PREFIX}{field.name}={'null' if field.default is None else field.default}"
        for field in fields(TuneSettings)
    )


def read_settings(texts: Sequence[str]) -> TuneSettings:
    """The settings in texts `tune.KEY=VALUE`. Raises BadInput on an unknown key or wrong value."""
    parsed = parse_overrides(texts)
    check_single_values(parsed)
    types = get_type_hints(TuneSettings, include_extras=True)
    values = {override.key.removeprefix(PREFIX): override.value for override in parsed}
    for problem in problems_of_mapping(values, types, PREFIX, ()):
        raise BadInput(f"{problem.key}: {problem.reason}")
    return TuneSettings(**{name: convert(value, types[name]) for name, value in values.items()})


@dataclass(frozen=True)
class Measure:
    """What trials are compared by.

    Attributes:
        name: as the user gives it.
        column: of metrics.csv.
        of_validation: whether it is a mean over validation houses; then a run's value is its best
            evaluation, else the last in metrics.csv.
    """

    name: str
    column: str
    of_validation: bool
    direction: Direction

    @property
    def sign(self) -> int:
        """The factor that makes lower values better."""
        return 1 if self.direction == MINIMISE else -1


NOT_VALIDATED = ("T_certify", "ratio_certify", "optimum_100", "gap_100")  # measured in tests alone
ON_VALIDATION = ("finished", *(name for name in MEASURES if name not in NOT_VALIDATED))
COLUMNS = (  # of metrics.csv, beside those of validation
    *("reward", "episode_reward", "shaping", "collision", "spill", "updates", "epsilon", "gamma"),
    "stage",
    *("loss", "loss_critic", "grad_norm", "entropy", "kl_approx", "clip_fraction", "imitation"),
    *("ground_sender_map", "ground_missing"),
)
HIGHER_IS_BETTER = (
    *("finished", "coverage", "coverage_auc", "return", "reward", "episode_reward"),
    *("spill", "spill_cleaned"),
)
LOWER_IS_BETTER = (
    *(name for name in MEASURES if name.startswith(("T_", "ratio_")) or "_per_cell" in name),
    *("redundancy", "overlap", "balance", "bumps", "collisions", "spill_delay"),
    *("messages", "edges", "bits", "rounds", "loss", "loss_critic"),
    *("ground_sender_map", "ground_missing"),
)


def measure_of(settings: TuneSettings, config: DictConfig) -> Measure:
    """The measure that the settings name, with its direction.

    Raises BadInput where there is none of that name, or its direction is not known.
    """
    houses = has_houses(config)
    validated = ON_VALIDATION if houses else ("return",)
    name = settings.measure or (config.trainer.select_by if houses else "return")
    key = f"{PREFIX}measure={name}"
    bare = name.removeprefix(VALIDATION)
    of_validation = bare in validated
    own_agent = config.agent._target_.startswith(f"{packages()[0].name}.")
    if not of_validation and (bare != name or own_agent) and name not in COLUMNS:
        raise BadInput(f"{key}: no such measure; {choices(bare, (*validated, *COLUMNS))}")
    if "csv" not in (config.logger or ()):
        raise BadInput("logger: a search reads metrics.csv; add csv, as in logger=[csv]")
    direction = settings.direction
    if direction is None and bare not in (*HIGHER_IS_BETTER, *LOWER_IS_BETTER):
        raise BadInput(f"{key}: give {PREFIX}direction={MINIMISE} or {MAXIMISE} with it")
    if direction is None:
        direction = MAXIMISE if bare in HIGHER_IS_BETTER else MINIMISE
    return Measure(bare, f"{VALIDATION}{bare}" if of_validation else name, of_validation, direction)
