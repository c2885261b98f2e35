"""Scores of houses that compare across houses: how near a policy comes to the least time.

    score = least T_100 / T_100,    0 where the house was not finished

The least is the proven bound of the house (`bound_100`), which nobody can beat, so that scores lie
between 0 and 1; or the time of an oracle in the same house, which may be beaten (score above 1; an
optimality gap counts it as 1). A house not finished scores 0, whatever its `max_steps`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from marl_clean.errors import BadInput
from marl_clean.evaluation.records import House, sample
from marl_clean.evaluation.statistics import as_sample

BOUND = "bound_100"
TIME = "T_100"


def scores_to_bound(runs: Sequence[Sequence[House]]) -> Float[np.ndarray, "run house"]:
    """bound_100 / T_100 of each house; NaN where it has no bound, or a bound of 0."""
    return _quotient(as_sample([[house.get(BOUND) for house in run] for run in runs]), runs)


def scores_to_oracle(
    runs: Sequence[Sequence[House]], oracle: Sequence[Sequence[House]]
) -> Float[np.ndarray, "run house"]:
    """The oracle's T_100, the mean over its runs, divided by a policy's in the same house.

    A house that the oracle did not finish counts as its max_steps. Raises BadInput where the houses
    differ in number.
    """
    if len(oracle[0]) != len(runs[0]):
        raise BadInput(
            f"an oracle needs the same houses, not {len(oracle[0])} instead of {len(runs[0])}"
        )
    return _quotient(sample(oracle, TIME).mean(0, keepdims=True), runs)


def times(runs: Sequence[Sequence[House]], measure: str = TIME) -> Float[np.ndarray, "run house"]:
    """The steps until a house was `measure` clean, infinite where it never was."""
    values = as_sample([[house[measure] for house in run] for run in runs])
    return np.where(np.isnan(values), np.inf, values)


def _quotient(
    least: Float[np.ndarray, "run_or_1 house"], runs: Sequence[Sequence[House]]
) -> Float[np.ndarray, "run house"]:
    valid = least > 0  # False for NaN
    return np.where(valid, np.where(valid, least, 1.0) / np.maximum(times(runs), 1), np.nan)
