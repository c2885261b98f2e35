"""Our statistics against rliable's, on the same numbers and the same draws.

    python -m venv /tmp/rliable
    /tmp/rliable/bin/pip install rliable "pandas<3" jaxtyping
    PYTHONPATH=. /tmp/rliable/bin/python tests/development/against_rliable.py

rliable is archived and needs an environment of its own, so it is no dependency. It draws from
NumPy's global generator, one resample after the other; here ours draws from the same, so that
intervals agree too, and not only up to chance. Prints the largest difference of each kind; ends
with 1 where one is above 1e-9.
"""

import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

import numpy as np
from rliable import library, metrics

from marl_clean.evaluation import aggregates, improvement, profiles, resampling
from marl_clean.evaluation.resampling import Resampling, interval

DRAWS = 200
SHAPES = ((1, 6), (3, 5), (5, 20), (10, 7))  # runs by tasks
AGGREGATES = {
    "mean": metrics.aggregate_mean,
    "median": metrics.aggregate_median,
    "iqm": metrics.aggregate_iqm,
    "optimality_gap": metrics.aggregate_optimality_gap,
}
MOST = 1e-9
HOW = Resampling.STRATIFIED


def main() -> int:
    """Print the largest differences, and return the exit code."""
    share_the_draws()
    largest: dict[str, float] = {}
    for name, ours, theirs in compared():
        difference = float(np.abs(np.asarray(ours) - np.asarray(theirs)).max())
        largest[name] = max(largest.get(name, 0.0), difference)
    packages = ", ".join(f"{name} {version(name)}" for name in ("rliable", "numpy", "pandas"))
    print(f"largest differences to {packages}")
    for name, difference in largest.items():
        print(f"{name:32} {difference:.1e}")
    return int(max(largest.values()) > MOST)


def share_the_draws() -> None:
    """Let ours draw resample by resample from NumPy's global generator, as rliable does."""

    def draw_runs(how: Resampling, rng: Any, shape: tuple[int, int, int]) -> Any:
        draws, runs, houses = shape
        return np.stack([np.random.choice(runs, (runs, houses)) for _ in range(draws)])

    def singly(draws: int, size: int) -> Iterator[int]:
        return iter([1] * draws)

    for module in (resampling, improvement):
        vars(module).update(draw_runs=draw_runs, blocks=singly)


def compared() -> Iterator[tuple[str, Any, Any]]:
    """What is compared: its name, our numbers, rliable's."""
    for runs, tasks in SHAPES:
        rng = np.random.default_rng(runs)
        scores = rng.normal(0.7, 0.4, (runs, tasks)).round(1)  # with ties
        others = rng.normal(0.6, 0.4, (runs + 1, tasks)).round(1)
        for name, theirs in AGGREGATES.items():
            yield from of_aggregate(name, theirs, scores)
        yield from of_profile(scores)
        yield from of_improvement(scores, others)


def of_aggregate(name: str, theirs: Callable[..., Any], scores: Any) -> Iterator[Any]:
    """An aggregate and its interval."""
    result = from_seed(lambda: interval(scores, aggregates.STATISTICS[name], HOW, DRAWS))
    yield name, result.value, theirs(scores)
    ends = from_seed(lambda: estimates(scores, lambda x: np.array([theirs(x)])))
    yield f"{name}, interval", result.ci95, ends.ravel()


def of_profile(scores: Any) -> Iterator[Any]:
    """A performance profile and its band."""
    taus = np.linspace(0, 1.5, 31)
    ours = from_seed(lambda: profiles.profile(scores, taus, HOW, DRAWS))
    shares, bands = from_seed(
        lambda: library.create_performance_profile({"a": scores}, taus, reps=DRAWS)
    )
    yield "profile", ours.share, shares["a"]
    yield "profile, band", (ours.low, ours.high), bands["a"]


def of_improvement(scores: Any, others: Any) -> Iterator[Any]:
    """The probability of improvement and its interval."""
    name, theirs = "probability of improvement", metrics.probability_of_improvement
    result = from_seed(lambda: improvement.probability_of_improvement(scores, others, HOW, DRAWS))
    yield name, result.value, theirs(scores, others)
    ends = from_seed(lambda: estimates((scores, others), lambda x, y: np.array([theirs(x, y)])))
    yield f"{name}, interval", result.ci95, ends.ravel()


def from_seed(compute: Callable[[], Any]) -> Any:
    """What `compute` returns when NumPy's global generator starts from 0."""
    np.random.seed(0)
    return compute()


def estimates(scores: Any, statistic: Callable[..., Any]) -> Any:
    """rliable's 95 % interval of a statistic."""
    return library.get_interval_estimates({"a": scores}, statistic, reps=DRAWS)[1]["a"]


if __name__ == "__main__":
    sys.exit(main())
