"""Performance profiles and probabilities of improvement of the rows of a comparison."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.env.viewer import INK, ROBOTS
from marl_clean.evaluation.efficiency import Curve
from marl_clean.report.axes import (
    LEGEND_LINE,
    STYLE,
    legend_below,
    new_figure,
    row_style,
    seeds_label,
    unit,
)

Row = Mapping[str, Any]  # of evaluation.row_statistics


def draw_profiles(title: str, rows: Sequence[Row]) -> Figure:
    """Two panels: the share of scores above tau, and the share of houses finished by a step.

    Bands are pointwise 95 % intervals over runs and houses.
    """
    with matplotlib.rc_context(STYLE):
        figure = new_figure(9.0, 3.4 + 0.2 * len(rows))
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        scores, steps = figure.subplots(1, 2)
        _draw_curves(scores, rows, "profile")
        scores.set_title("share of houses with a score above tau", loc="left")
        scores.set_xlabel("tau; score: bound_100 / T_100, 0 if not finished")
        _draw_curves(steps, rows, "finished_by")
        steps.set_title("share of houses finished", loc="left")
        steps.set_xlabel("by step")
        handles, names = steps.get_legend_handles_labels()
        figure.legend(
            handles, names,
            frameon=False, fontsize=7, ncols=2, handlelength=LEGEND_LINE, loc="outside lower left",
        )  # fmt: skip
        return figure


def draw_improvement(title: str, rows: Sequence[Row]) -> Figure:
    """How often each row finishes a house sooner than the reference does, with its interval."""
    shown = [row for row in rows if "improvement" in row]
    with matplotlib.rc_context(STYLE):
        figure = new_figure(7.0, 1.5 + 0.34 * len(shown))
        reference = shown[0]["improvement"]["over"] if shown else ""
        figure.suptitle(f"{title}\nreference: {reference}", fontsize=9, x=0.01, ha="left")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, measure in zip(panels, ("T_90", "T_100"), strict=True):
            axes.axvline(0.5, color=unit(INK), linewidth=0.8)
            for place, row in enumerate(shown):
                chance = row["improvement"][measure]
                if chance["value"] is None:
                    continue
                colour = unit(ROBOTS[0] if row["seeds"] else INK)
                axes.plot(chance["ci95"], [place, place], color=colour, linewidth=1.5)
                fill = "full" if row["seeds"] else "none"
                axes.plot(chance["value"], place, "o", color=colour, fillstyle=fill)
            axes.set_xlim(-0.03, 1.03)
            axes.set_title(f"P({measure} less than the reference's)", loc="left")
            axes.grid(axis="x", alpha=0.25, linewidth=0.5)
        names = [seeds_label(row["row"], len(row["seeds"])) for row in shown]
        panels[0].set_yticks(range(len(shown)), names)
        panels[0].set_ylim(len(shown) - 0.5, -0.5)
        return figure


def draw_efficiency(title: str, curves: Mapping[str, Mapping[str, Curve]]) -> Figure:
    """A panel a measure: its interquartile mean on validation houses against frames of training.

    `curves` are of each row, then of each measure. Bands are 95 % intervals over whole seeds.
    """
    measures = list(dict.fromkeys(name for of_row in curves.values() for name in of_row))
    with matplotlib.rc_context(STYLE):
        figure = new_figure(3.4 * len(measures), 3.0 + 0.2 * len(curves))
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        [panels] = figure.subplots(1, len(measures), squeeze=False)
        for axes, measure in zip(panels, measures, strict=True):
            for place, (label, of_row) in enumerate(curves.items()):
                if (curve := of_row.get(measure)) is None:
                    continue
                style, seeds = row_style(place), seeds_label(label, int(curve.seeds.max()))
                axes.fill_between(
                    curve.frames, curve.low, curve.high, color=style["color"], alpha=0.15
                )
                axes.plot(
                    curve.frames, curve.value, **style, linewidth=1.4, marker=".", label=seeds
                )
            axes.set_title(f"{measure} on validation houses, IQM", loc="left")
            axes.set_xlabel("frames")
            axes.grid(alpha=0.25, linewidth=0.5)
        legend_below(figure, "center")
        return figure


def _draw_curves(axes: Axes, rows: Sequence[Row], kind: str) -> None:
    for place, row in enumerate(rows):
        curve = row[kind]
        if curve is None:
            continue
        style = row_style(place) | ({} if row["seeds"] else {"color": unit(INK)})
        band = (curve["grid"], curve["low"], curve["high"])
        axes.fill_between(*band, color=style["color"], alpha=0.15)
        label = seeds_label(row["row"], len(row["seeds"]))
        axes.plot(curve["grid"], curve["share"], **style, linewidth=1.4, label=label)
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.25, linewidth=0.5)
