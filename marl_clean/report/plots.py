"""The plots of a report, each with the numbers that it shows as a table.

Every seed is a dot or a thin line, every mean has its 95 % interval.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from marl_clean.evaluation.aggregates import mean
from marl_clean.evaluation.efficiency import sample_efficiency
from marl_clean.evaluation.records import TIMES, Entry
from marl_clean.report.chart import HEIGHT, Axis, Chart, Kind
from marl_clean.report.metrics import Series

LANE, GAP = 8, 10  # pixels of a row's interval, and between measures
SHOWN_TIMES = tuple(f"T_{name}" for name in TIMES if name.isdigit())
CURVES = ("T_100", "finished")
SHOWN_STEPS = 10  # of a profile, in the table behind it
Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class Plot:
    """A chart, what it shows in a sentence, and its numbers; the first row holds the titles."""

    title: str
    chart: Chart
    numbers: Rows


@dataclass(frozen=True)
class Shown:
    """One row of a report.

    Attributes:
        label: its name on the page.
        pooled, seeds: the entries of its seeds, as one and each.
        statistics: its line of `evaluation.row_statistics`.
    """

    label: str
    pooled: Entry
    seeds: Sequence[Entry]
    statistics: Mapping[str, Any]


def plots(rows: Sequence[Shown]) -> list[Plot]:
    """All plots of one world for which there are numbers."""
    drawn = [times(rows), finished_by(rows), scores(rows), cost(rows)]
    return [plot for plot in drawn if plot is not None]


def times(rows: Sequence[Shown]) -> Plot:
    """Steps to 90, 95, 99 and 100 % with intervals, every seed as a dot."""
    height = max(HEIGHT, 46 + len(SHOWN_TIMES) * (LANE * len(rows) + GAP))
    chart = Chart(Axis("steps", low=0), Axis(names=SHOWN_TIMES), height)
    numbers = [["policy", *SHOWN_TIMES]]
    lane = 0.8 / len(rows)
    for index, row in enumerate(rows):
        chart.names[index] = row.label
        cells = []
        for place, measure in enumerate(SHOWN_TIMES):
            summary = row.pooled["summary"][measure]
            low, high = summary["ci95"]
            at = place + (index - (len(rows) - 1) / 2) * lane
            cell = f"{summary['mean']:.1f} [{low:.1f}, {high:.1f}]"
            own = [entry["summary"][measure]["mean"] for entry in row.seeds]
            chart.line(index, [low, high], [at, at], Kind.SPAN)
            chart.line(index, own, [at] * len(own), Kind.SEED)
            title = f"{row.label}, {measure}: {cell}"
            chart.line(index, [summary["mean"]], [at], Kind.POINT, title)
            cells.append(cell)
        numbers.append([row.label, *cells])
    return Plot("Steps to clean 90, 95, 99 and 100 % of a house", chart, numbers)


def finished_by(rows: Sequence[Shown]) -> Plot:
    """The share of houses finished by each step, with pointwise bands."""
    title = "Share of houses finished by a step"
    return _shares(title, rows, "finished_by", Axis("steps"), "houses finished, %", "{:.0f}")


def scores(rows: Sequence[Shown]) -> Plot:
    """The performance profile: the share of houses with a score above each threshold."""
    title = "Share of houses with a score above tau; score: bound_100 / T_100, 0 if not finished"
    return _shares(title, rows, "profile", Axis("tau"), "houses, %", "{:.1f}")


def _shares(
    title: str, rows: Sequence[Shown], kind: str, x: Axis, y_label: str, number: str
) -> Plot:
    shown_rows = [(index, row) for index, row in enumerate(rows) if row.statistics[kind]]
    grid = shown_rows[0][1].statistics[kind]["grid"] if shown_rows else [0.0, 1.0]
    chart = Chart(replace(x, low=0, high=grid[-1]), Axis(y_label, 0, 100))
    shown = range(0, len(grid), max(1, len(grid) // SHOWN_STEPS))
    numbers = [["policy", *(number.format(grid[place]) for place in shown)]]
    for index, row in shown_rows:
        share, low, high = (
            [100 * value for value in row.statistics[kind][name]]
            for name in ("share", "low", "high")
        )
        chart.names[index] = row.label
        chart.band(index, grid, low, high)
        chart.line(index, grid, share, title=row.label)
        cells = (f"{share[at]:.0f} [{low[at]:.0f}, {high[at]:.0f}] %" for at in shown)
        numbers.append([row.label, *cells])
    return Plot(title, chart, numbers)


def changes(shown: Mapping[str, Sequence[Mapping[str, Any]]], measure: str = "T_100") -> Plot:
    """What each intervention adds to a time; `shown`: the paired differences of each row."""
    names = list(dict.fromkeys(result["row"] for results in shown.values() for result in results))
    height = max(HEIGHT, 46 + len(names) * (LANE * len(shown) + GAP))
    chart = Chart(
        Axis(f"{measure}, intervened minus untouched, steps", zero=True), Axis(names=names), height
    )
    numbers = [["policy", *names]]
    lane = 0.8 / len(shown)
    for index, (label, results) in enumerate(shown.items()):
        chart.names[index] = label
        cells = dict.fromkeys(names, "")
        for result in results:
            change = result[measure]
            if change["mean"] is None:
                continue
            low, high = change["ci95"]
            at = names.index(result["row"]) + (index - (len(shown) - 1) / 2) * lane
            cell = f"{change['mean']:+.1f} [{low:+.1f}, {high:+.1f}]"
            chart.line(index, [low, high], [at, at], Kind.SPAN)
            title = f"{label}, {result['row']}: {cell}"
            chart.line(index, [change["mean"]], [at], Kind.POINT, title)
            cells[result["row"]] = cell
        numbers.append([label, *cells.values()])
    return Plot(f"What changed messages add to {measure}", chart, numbers)


def curves(learnt: Mapping[str, Mapping[str, Mapping[str, Series]]]) -> list[Plot]:
    """What the runs of each row logged on validation houses; `learnt` is row -> run -> columns."""
    drawn = [curve(learnt, measure) for measure in CURVES]
    return [plot for plot in drawn if plot is not None]


def curve(learnt: Mapping[str, Mapping[str, Mapping[str, Series]]], measure: str) -> Plot | None:
    """One measure: a thin line a seed, a thick one their mean with its band; None without any."""
    column = f"validation/{measure}"
    is_share = measure == "finished"
    y = Axis(measure, 0, 1) if is_share else Axis(measure)
    chart = Chart(Axis("frames", low=0), y)
    numbers = [["policy", "frames", "mean", "seeds"]]
    for index, (label, runs) in enumerate(learnt.items()):
        lines = [columns[column] for columns in runs.values() if column in columns]
        of_seeds = sample_efficiency(lines, mean)
        if of_seeds is None:
            continue
        chart.names[index] = label
        chart.band(index, *(getattr(of_seeds, name).tolist() for name in ("frames", "low", "high")))
        for line in lines if len(lines) > 1 else ():
            frames, values = zip(*line, strict=True)
            chart.line(index, frames, values, Kind.THIN if len(line) > 1 else Kind.SEED)
        kind = Kind.LINE if len(of_seeds.frames) > 1 else Kind.POINT
        chart.line(index, of_seeds.frames.tolist(), of_seeds.value.tolist(), kind, label)
        for frame, value, low, high, seeds in zip(
            *(getattr(of_seeds, name) for name in ("frames", "value", "low", "high", "seeds")),
            strict=True,
        ):
            interval = "" if np.isnan(low) else f" [{low:.3g}, {high:.3g}]"  # one seed has none
            numbers.append([label, f"{frame:,.0f}", f"{value:.3g}{interval}", str(seeds)])
    if len(numbers) == 1:
        return None
    return Plot(f"{measure} on validation houses while learning", chart, numbers)


def cost(rows: Sequence[Shown]) -> Plot | None:
    """Steps to clean everything against the bits sent in a step."""
    talking = [row for row in rows if row.pooled["summary"].get("bits", {}).get("mean")]
    if not talking:
        return None
    chart = Chart(Axis("bits a step, all robots"), Axis("T_100, steps"))
    numbers = [["policy", "bits a step", "T_100"]]
    for index, row in enumerate(rows):
        if "bits" not in row.pooled["summary"]:
            continue
        bits = row.pooled["summary"]["bits"]["mean"]
        summary = row.pooled["summary"]["T_100"]
        sent, took = (
            [entry["summary"][name]["mean"] for entry in row.seeds] for name in ("bits", "T_100")
        )
        cells = [f"{bits:.1f}", f"{summary['mean']:.1f}"]
        chart.names[index] = row.label
        chart.line(index, [bits, bits], summary["ci95"], Kind.SPAN)
        chart.line(index, sent, took, Kind.SEED)
        title = f"{row.label}: {cells[0]} bits, T_100 {cells[1]}"
        chart.line(index, [bits], [summary["mean"]], Kind.POINT, title)
        numbers.append([row.label, *cells])
    return Plot("Steps to clean everything against bits a step", chart, numbers)
