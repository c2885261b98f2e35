"""The plots of a report, each with the numbers that it shows as a table.

Every seed is a dot or a thin line, every mean has its 95 % interval.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from marl_clean.evaluation.aggregates import mean
from marl_clean.evaluation.efficiency import sample_efficiency
from marl_clean.evaluation.records import TIMES, Entry
from marl_clean.report.axes import LEGEND_LINE, new_figure, row_colour, row_mark, row_style
from marl_clean.report.curve import Series
from marl_clean.report.vectors import PAGE_STYLE

WIDTH, HEIGHT = 4.2, 2.9  # inches: at the smallest width of a page, text is of its usual size
SHOWN_TIMES = tuple(f"T_{name}" for name in TIMES if name.isdigit())
CURVES = ("T_100", "finished")
SHOWN_STEPS = 10  # of a profile, in the table behind it
Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class Plot:
    """A figure, what it shows in a sentence, and its numbers; the first row holds the titles."""

    title: str
    figure: Figure
    numbers: Rows


@dataclass(frozen=True)
class Shown:
    """One row of a report.

    Attributes:
        label: its name on the page.
        pooled, seeds: the entries of its seeds, as one and each.
        finished_by: the share of houses finished by a step, as `evaluation.row_statistics` has it.
    """

    label: str
    pooled: Entry
    seeds: Sequence[Entry]
    finished_by: Mapping[str, Sequence[float]]


def plots(rows: Sequence[Shown]) -> list[Plot]:
    """All plots of one world for which there are numbers."""
    drawn = [times(rows), profile(rows), cost(rows)]
    return [plot for plot in drawn if plot is not None]


def times(rows: Sequence[Shown]) -> Plot:
    """Steps to 90, 95, 99 and 100 % with intervals, every seed as a dot."""
    figure, axes = _axes(HEIGHT + 0.25 * max(0, len(rows) - 4))
    numbers = [["policy", *SHOWN_TIMES]]
    height = 0.8 / len(rows)
    for index, row in enumerate(rows):
        cells = []
        for place, measure in enumerate(SHOWN_TIMES):
            summary = row.pooled["summary"][measure]
            low, high = summary["ci95"]
            at = place + (index - (len(rows) - 1) / 2) * height
            label = row.label if place == 0 else None
            axes.plot([low, high], [at, at], color=row_colour(index), linewidth=1.5)
            axes.plot(summary["mean"], at, row_mark(index), color=row_colour(index), label=label)
            for entry in row.seeds:
                own = entry["summary"][measure]["mean"]
                axes.plot(own, at, ".", color=row_colour(index), markersize=3, alpha=0.6)
            cells.append(f"{summary['mean']:.1f} [{low:.1f}, {high:.1f}]")
        numbers.append([row.label, *cells])
    axes.set_yticks(range(len(SHOWN_TIMES)), list(SHOWN_TIMES))
    axes.set_ylim(len(SHOWN_TIMES) - 0.5, -0.5)
    axes.set_xlim(left=0)
    axes.set_xlabel("steps")
    return _finish("Steps to clean 90, 95, 99 and 100 % of a house", figure, axes, numbers)


def profile(rows: Sequence[Shown]) -> Plot:
    """The share of houses finished by each step, with pointwise bands."""
    figure, axes = _axes()
    steps = rows[0].finished_by["grid"]
    shown = range(0, len(steps), max(1, len(steps) // SHOWN_STEPS))
    numbers = [["policy", *(f"{steps[place]:.0f}" for place in shown)]]
    for index, row in enumerate(rows):
        share, low, high = (
            [100 * value for value in row.finished_by[name]] for name in ("share", "low", "high")
        )
        axes.fill_between(steps, low, high, color=row_colour(index), alpha=0.15, linewidth=0)
        axes.plot(steps, share, **row_style(index), label=row.label, linewidth=1.3)
        cells = (f"{share[at]:.0f} [{low[at]:.0f}, {high[at]:.0f}] %" for at in shown)
        numbers.append([row.label, *cells])
    axes.set(xlabel="steps", ylabel="houses finished, %", ylim=(-2, 102), xlim=(0, steps[-1]))
    return _finish("Share of houses finished by a step", figure, axes, numbers)


def curves(learnt: Mapping[str, Mapping[str, Mapping[str, Series]]]) -> list[Plot]:
    """What the runs of each row logged on validation houses; `learnt` is row -> run -> columns."""
    drawn = [curve(learnt, measure) for measure in CURVES]
    return [plot for plot in drawn if plot is not None]


def curve(learnt: Mapping[str, Mapping[str, Mapping[str, Series]]], measure: str) -> Plot | None:
    """One measure: a thin line a seed, a thick one their mean with its band; None without any."""
    column = f"validation/{measure}"
    figure, axes = _axes()
    numbers = [["policy", "frames", "mean", "seeds"]]
    for index, (label, runs) in enumerate(learnt.items()):
        lines = [columns[column] for columns in runs.values() if column in columns]
        of_seeds = sample_efficiency(lines, mean)
        if of_seeds is None:
            continue
        for line in lines:
            axes.plot(*zip(*line, strict=True), color=row_colour(index), linewidth=0.6, alpha=0.5)
        band = (of_seeds.frames, of_seeds.low, of_seeds.high)
        axes.fill_between(*band, color=row_colour(index), alpha=0.15, linewidth=0)
        axes.plot(of_seeds.frames, of_seeds.value, **row_style(index), label=label)
        for frames, value, low, high, seeds in zip(
            *(getattr(of_seeds, name) for name in ("frames", "value", "low", "high", "seeds")),
            strict=True,
        ):
            interval = "" if np.isnan(low) else f" [{low:.3g}, {high:.3g}]"  # one seed has none
            numbers.append([label, f"{frames:,.0f}", f"{value:.3g}{interval}", str(seeds)])
    if len(numbers) == 1:
        return None
    axes.set_xlabel("frames")
    axes.set_ylabel(measure)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    return _finish(f"{measure} on validation houses while learning", figure, axes, numbers)


def cost(rows: Sequence[Shown]) -> Plot | None:
    """Steps to clean everything against the bits sent in a step."""
    talking = [row for row in rows if row.pooled["summary"].get("bits", {}).get("mean")]
    if not talking:
        return None
    figure, axes = _axes()
    numbers = [["policy", "bits a step", "T_100"]]
    for index, row in enumerate(rows):
        if "bits" not in row.pooled["summary"]:
            continue
        bits = row.pooled["summary"]["bits"]["mean"]
        summary = row.pooled["summary"]["T_100"]
        axes.plot([bits, bits], summary["ci95"], color=row_colour(index), linewidth=1.5)
        axes.plot(bits, summary["mean"], row_mark(index), color=row_colour(index), label=row.label)
        for entry in row.seeds:
            own = [entry["summary"][name]["mean"] for name in ("bits", "T_100")]
            axes.plot(*own, row_mark(index), color=row_colour(index), markersize=3)
        numbers.append([row.label, f"{bits:.1f}", f"{summary['mean']:.1f}"])
    axes.set(xlabel="bits a step, all robots", ylabel="T_100, steps")
    return _finish("Steps to clean everything against bits a step", figure, axes, numbers)


def _axes(height: float = HEIGHT) -> tuple[Figure, Axes]:
    with matplotlib.rc_context(PAGE_STYLE):
        figure = new_figure(WIDTH, height)
        axes = figure.subplots()
    axes.set_axisbelow(True)
    return figure, axes


def _finish(title: str, figure: Figure, axes: Axes, numbers: Rows) -> Plot:
    """The plot with its legend below the axes, where it covers no line."""
    with matplotlib.rc_context(PAGE_STYLE):
        handles, labels = axes.get_legend_handles_labels()
        columns = 1 if max((len(label) for label in labels), default=0) > 24 else 2
        figure.legend(
            handles, labels,
            frameon=False, fontsize=7, ncols=columns, handlelength=LEGEND_LINE,
            loc="outside lower center",
        )  # fmt: skip
    return Plot(title, figure, numbers)
