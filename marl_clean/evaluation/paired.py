"""Paired differences of policies to a reference, on the same houses and starts, per seed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from marl_clean.evaluation.records import SHOWN_EXTERNAL, Entry, House, sample
from marl_clean.evaluation.statistics import as_sample, holm, paired_difference, paired_p

FINISHED = "finished"
COMPARED = ("T_90", "T_100", FINISHED)
LEVEL = 0.05
CAPTION = (
    "Row minus reference, house by house and seed by seed; lower times are better.\n"
    "Brackets: 95 % bootstrap interval over seeds and then houses, too narrow for few seeds.\n"
    "**: p < 0.05 after Holm's correction over all comparisons of this table, *: before it;\n"
    "p over seeds and houses; of one seed over houses alone: then it holds for these weights only."
)


@dataclass(frozen=True)
class Row:
    """One setting: its label, its runs by seed, and its number of parameters.

    A planner has one run, which is paired with every seed.
    """

    label: str
    runs: Mapping[Any, Entry]  # by seed; a planner's by None
    parameters: int | None = None


def differences(rows: Sequence[Row], reference: Row) -> list[dict[str, Any]]:
    """Each row minus the reference, over the seeds that both have.

    A list of `{"row", "reference", "seeds", "parameters", measure: {"mean", "ci95", "p",
    "p_holm"}}`; rows that share no seed with it are left out. Measures are those of
    evaluation.json, a time not reached counts as max_steps; `finished` is 1 or 0 per house.
    External tasks have `return` alone.
    """
    results = []
    for row in rows:
        seeds = common_seeds(row, reference)
        if row is reference or not seeds:
            continue
        result: dict[str, Any] = {"row": row.label, "reference": reference.label, "seeds": seeds}
        result["parameters"] = row.parameters
        for measure in compared(reference):
            measured, baseline = (values(side, seeds, measure) for side in (row, reference))
            estimate = paired_difference(measured, baseline)
            interval = None if estimate.ci95 is None else list(estimate.ci95)
            p = paired_p(measured, baseline)
            result[measure] = {"mean": estimate.mean, "ci95": interval, "p": p}
        results.append(result)
    cells = [result[measure] for result in results for measure in compared(reference)]
    for cell, corrected in zip(cells, holm([cell["p"] for cell in cells]), strict=True):
        cell["p_holm"] = corrected
    return results


def compared(row: Row) -> tuple[str, ...]:
    """The measures compared between rows of this row's world."""
    [first, *_] = row.runs.values()
    return COMPARED if "T_100" in first["houses"][0] else SHOWN_EXTERNAL


def common_seeds(row: Row, reference: Row) -> list[int]:
    """The seeds of both rows."""
    both = [{seed for seed in side.runs if seed is not None} for side in (row, reference)]
    if None in row.runs or None in reference.runs:  # a planner is paired with every seed
        return sorted(both[0] | both[1])
    return sorted(both[0] & both[1])


def unpaired_seeds(rows: Sequence[Row], reference: Row) -> list[str]:
    """A line for each row with seeds that only it or only the reference has."""
    lines = []
    for row in rows:
        if None in row.runs or None in reference.runs:  # a planner is paired with every seed
            continue
        seeds = ", ".join(str(seed) for seed in sorted({*row.runs} ^ {*reference.runs}))
        if seeds:
            lines.append(f"{row.label}: {seeds}")
    return lines


def values(row: Row, seeds: Sequence[int], measure: str) -> Float[np.ndarray, "run house"]:
    """A measure's values, one row per run; a planner has one row."""
    entries = [row.runs[None]] if None in row.runs else [row.runs[seed] for seed in seeds]
    runs: list[Sequence[House]] = [entry["houses"] for entry in entries]
    if measure == FINISHED:
        return as_sample([[float(house["T_100"] is not None) for house in run] for run in runs])
    return sample(runs, measure)


def make_paired_table(results: Sequence[Mapping[str, Any]], reference: Row) -> Table:
    """The differences as a table in the terminal."""
    size = f" ({reference.parameters:,} parameters)" if reference.parameters else ""
    table = Table(
        title=f"minus {reference.label}{size}",
        caption=CAPTION,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    networks = any(
        result["parameters"] is not None or len(result["seeds"]) > 1 for result in results
    )
    table.add_column("", no_wrap=True)
    for title in (*(("parameters", "seeds") if networks else ()), *compared(reference)):
        table.add_column(title, justify="right", no_wrap=True)
    for result in results:
        parameters = "-" if result["parameters"] is None else f"{result['parameters']:,}"
        about = (parameters, str(len(result["seeds"]))) if networks else ()
        cells = [cell_of(result[measure], measure) for measure in compared(reference)]
        table.add_row(result["row"], *about, *cells)
    return table


def cell_of(difference: Mapping[str, Any], measure: str) -> str:
    """A difference and its interval, with a star where p < LEVEL, two where the corrected p is."""
    if difference["mean"] is None:
        return "-"
    scale = 100 if measure == FINISHED else 1
    mean, low, high = (
        f"{scale * value:+.1f}" for value in (difference["mean"], *difference["ci95"])
    )
    unit = " %" if measure == FINISHED else ""
    mark = ""
    if difference["p_holm"] < LEVEL:
        mark = "**"
    elif difference["p"] < LEVEL:
        mark = "*"
    return f"{mean}{unit} [{low}, {high}] {mark:2}"
