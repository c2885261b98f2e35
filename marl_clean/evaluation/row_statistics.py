"""What a comparison says of each row: aggregates, profiles, how often it beats the reference."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from marl_clean.evaluation.aggregates import aggregates, iqm, median
from marl_clean.evaluation.improvement import probability_of_improvement
from marl_clean.evaluation.paired import Row
from marl_clean.evaluation.profiles import Profile, finished_by, profile, score_grid, step_grid
from marl_clean.evaluation.records import SHOWN, SHOWN_EXTERNAL, House, sample
from marl_clean.evaluation.resampling import Interval, interval
from marl_clean.evaluation.scores import scores_to_bound, scores_to_oracle, times
from marl_clean.evaluation.statistics import estimate

TIMES = ("T_90", "T_100")
SCORE, TO_ORACLE = "score", "score_to_oracle"
NONE = "-"
CAPTION = (
    "IQM: mean of the middle half of all houses and seeds. Gap: 1 - mean of bound_100 / T_100,\n"
    "a house not finished as 0. P(sooner): how often a run finishes a house before one of\n"
    "{reference}, ties as half. 95 % intervals; of one seed over houses alone: then they hold for\n"
    "these weights only."
)
OF_ORACLE = "Gap to oracle: 1 - mean of the oracle's T_100 / T_100, ratios above 1 as 1."

Runs = list[Sequence[House]]


def row_statistics(
    rows: Sequence[Row], reference: Row | None, oracle: Row | None = None
) -> list[dict[str, Any]]:
    """Each row's statistics, as JSON writes them; a number is `{"value", "ci95": [low, high]}`.

    `row`, `house_set`, `n_agents`, `houses` (their number), `seeds` (none of a planner);
    `aggregates`: of each measure shown `mean`, `median`, `iqm`; of `score` (bound_100 / T_100) and
    `score_to_oracle` the `optimality_gap` too;
    `by_seed`: of each measure the mean over houses of each run, in the order of `seeds`;
    `profile`: the share of scores above tau; `finished_by`: the share of houses finished by a step;
    `improvement`: of each time how probably it is less than the reference's (`over`); of an
    external task how probably the return is more. Rows have the same houses. `recovered` and
    `protocols` are added by whoever knows the silent row, see `evaluation.gains`.
    """
    return [_statistics_of(row, reference, oracle) for row in rows]


def _statistics_of(row: Row, reference: Row | None, oracle: Row | None) -> dict[str, Any]:
    runs = runs_of(row)
    first = next(iter(row.runs.values()))
    timed = "T_100" in runs[0][0]
    measures = SHOWN if timed else SHOWN_EXTERNAL
    samples = {measure: sample(runs, measure) for measure in measures}
    result: dict[str, Any] = {
        "row": row.label,
        "house_set": first["house_set"],
        "n_agents": first["n_agents"],
        "houses": len(runs[0]),
        "seeds": [seed for seed in row.runs if seed is not None],
        "aggregates": {name: _of_measure(values) for name, values in samples.items()},
        "by_seed": {name: _means(values) for name, values in samples.items()},
    }
    if timed:
        result |= _of_scores(result["aggregates"], runs, oracle)
    if reference is not None and row is not reference:
        compared = TIMES if timed else SHOWN_EXTERNAL
        against = runs_of(reference)
        chances = {
            name: as_json(probability_of_improvement(_order(runs, name), _order(against, name)))
            for name in compared
        }
        result["improvement"] = {"over": reference.label, **chances}
    return result


def _of_scores(shown: dict[str, Any], runs: Runs, oracle: Row | None) -> dict[str, Any]:
    """Put the scores' aggregates among those `shown`, in place; return the profiles."""
    scores = {SCORE: scores_to_bound(runs)}
    if oracle is not None:
        scores[TO_ORACLE] = scores_to_oracle(runs, runs_of(oracle))
    for name, values in scores.items():
        shown[name] = {key: as_json(value) for key, value in aggregates(values, True).items()}
    steps = step_grid(max(house["max_steps"] for house in runs[0]))
    return {
        "profile": _curve(profile(scores[SCORE], score_grid())),
        "finished_by": _curve(finished_by(times(runs), steps)),
    }


def runs_of(row: Row) -> Runs:
    """The records of each of a row's runs."""
    return [entry["houses"] for entry in row.runs.values()]


def as_json(result: Interval) -> dict[str, Any]:
    """A number and its interval."""
    return {"value": result.value, "ci95": None if result.ci95 is None else list(result.ci95)}


def _of_measure(values: Float[np.ndarray, "run house"]) -> dict[str, Any]:
    mean = estimate(values)  # as in evaluation.json
    return {
        "mean": as_json(Interval(mean.mean, mean.ci95)),
        "median": as_json(interval(values, median)),
        "iqm": as_json(interval(values, iqm)),
    }


def _means(values: Float[np.ndarray, "run house"]) -> list[float | None]:
    return [estimate(run[None], draws=1).mean for run in values]


def _order(runs: Runs, measure: str) -> Float[np.ndarray, "run house"]:
    """Values of which more is better: a return, or minus a time."""
    return sample(runs, measure) if measure in SHOWN_EXTERNAL else -times(runs, measure)


def _curve(curve: Profile | None) -> dict[str, list[float]] | None:
    if curve is None:
        return None
    return {name: getattr(curve, name).tolist() for name in ("grid", "share", "low", "high")}


def make_statistics_table(statistics: Sequence[Mapping[str, Any]]) -> Table:
    """Means and interquartile means side by side, with the number of seeds."""
    titles, *lines = statistics_cells(statistics)
    table = Table(
        title=f"seeds and interquartile means ({statistics[0]['house_set']})",
        caption=caption_of(statistics),
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    for title in titles:
        justify: Literal["left", "right"] = "right" if table.columns else "left"
        table.add_column(title, justify=justify, no_wrap=True)
    for line in lines:
        table.add_row(*line)
    return table


def caption_of(statistics: Sequence[Mapping[str, Any]]) -> str | None:
    """What the columns of houses mean; an external task has none of them."""
    if "T_100" not in statistics[0]["aggregates"]:
        return None
    overs = [row["improvement"]["over"] for row in statistics if "improvement" in row]
    caption = CAPTION.format(reference=overs[0] if overs else "the reference")
    to_oracle = any(TO_ORACLE in row["aggregates"] for row in statistics)
    return f"{caption}\n{OF_ORACLE}" if to_oracle else caption


def statistics_cells(statistics: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The cells of the table of seeds and interquartile means, titles first."""
    overs = any("improvement" in row for row in statistics)
    timed = "T_100" in statistics[0]["aggregates"]
    measures = TIMES if timed else SHOWN_EXTERNAL
    titles = ["policy", "seeds"]
    titles += [title for measure in measures for title in (measure, f"IQM {measure}")]
    to_oracle = any(TO_ORACLE in row["aggregates"] for row in statistics)
    titles += ["gap"] if timed else []
    titles += ["gap to oracle"] if to_oracle else []
    titles += [f"P({'sooner' if timed else 'more'})"] if overs else []
    lines = [titles]
    for row in statistics:
        shown = row["aggregates"]
        cells = [row["row"], str(len(row["seeds"])) if row["seeds"] else NONE]
        for measure in measures:
            cells += [cell_of(shown[measure]["mean"]), cell_of(shown[measure]["iqm"])]
        if timed:
            cells.append(cell_of(shown[SCORE]["optimality_gap"], 2))
        if to_oracle:
            cells.append(cell_of(shown[TO_ORACLE]["optimality_gap"], 2))
        if overs:
            chance = row.get("improvement", {}).get(measures[-1])
            cells.append(NONE if chance is None else cell_of(chance, 2))
        lines.append(cells)
    return lines


def cell_of(number: Mapping[str, Any], digits: int = 1) -> str:
    """`value [low, high]`, or a dash where there is no value."""
    if number["value"] is None:
        return NONE
    low, high = number["ci95"]
    return f"{number['value']:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
