"""The share of an oracle's headroom that each row of a comparison recovers, against its bits."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.env.viewer import INK
from marl_clean.evaluation.gains import MEASURES
from marl_clean.report.axes import (
    STYLE,
    new_figure,
    row_colour,
    row_mark,
    seeds_label,
    unit,
)

LINEAR_UP_TO = 10  # bits a step: the axis begins at 0, and is logarithmic from here
Row = Mapping[str, Any]  # of evaluation.row_statistics, with `recovered`


def draw_recovered(
    title: str, rows: Sequence[Row], bits: Mapping[str, float], engineered: Collection[str]
) -> Figure:
    """A panel a time: 0 is the silent row, 1 the oracle; bars are 95 % intervals, small dots seeds.

    `bits`: those that a row's team sends in a step, by its name. Hollow: rows of `engineered`
    messages. Planners are left out: a random one would leave no room for the others.
    """
    shown = [row for row in rows if "recovered" in row and row["seeds"]]
    with matplotlib.rc_context(STYLE):
        figure = new_figure(9.0, 3.6 + 0.1 * len(shown))
        ends = shown[0]["recovered"]
        title += f"\n0: {ends['silent']}, 1: {ends['oracle']}; hollow: engineered messages"
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        for axes, measure in zip(figure.subplots(1, 2, sharey=True), MEASURES, strict=True):
            for end in (0, 1):
                axes.axhline(end, color=unit(INK), linewidth=0.8)
            for place, row in enumerate(shown):
                if row["recovered"][measure]["value"] is not None:
                    hollow = row["row"] in engineered
                    _draw_row(axes, row, measure, bits[row["row"]], place, hollow)
            axes.set_xscale("symlog", linthresh=LINEAR_UP_TO)
            axes.set_xlim(left=-1)
            axes.set_title(f"share of the headroom in {measure} recovered", loc="left")
            axes.set_xlabel("bits that the team sends in a step")
            axes.grid(alpha=0.25, linewidth=0.5)
        handles, names = axes.get_legend_handles_labels()
        figure.legend(handles, names, frameon=False, fontsize=7, ncols=2, loc="outside lower left")
        return figure


def _draw_row(axes: Axes, row: Row, measure: str, bits: float, place: int, hollow: bool) -> None:
    recovered = row["recovered"][measure]
    colour = row_colour(place)
    style: Any = {"color": colour, "fillstyle": "none" if hollow else "full"}
    label = seeds_label(row["row"], len(row["recovered"]["seeds"]))
    axes.plot([bits, bits], recovered["ci95"], color=colour, linewidth=1.2)
    axes.plot(bits, recovered["value"], row_mark(place), label=label, markersize=6, **style)
    dots = of_seeds(row, measure)
    axes.plot([bits] * len(dots), dots, "o", color=colour, markersize=2.5, alpha=0.5)


def of_seeds(row: Row, measure: str) -> list[float]:
    """What each seed recovers, between the means of silent and oracle; their mean is the row's."""
    recovered = row["recovered"]
    by_seed = dict(zip(row["seeds"], row["by_seed"][measure], strict=True))
    own = [by_seed[seed] for seed in recovered["seeds"]]
    share, gap = recovered[measure]["value"], recovered[measure]["gap"]["value"]
    return [share + (sum(own) / len(own) - time) / gap for time in own]
