"""Several policies beside each other: shares finished and times, with their intervals."""

from collections.abc import Mapping

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.evaluation.records import Entry
from marl_clean.evaluation.table import YARDSTICK
from marl_clean.report.axes import STYLE, new_figure, unit
from marl_clean.viewer import INK, ROBOTS

TIMES = ("T_90", "T_100")

Pair = tuple[Entry, Entry]  # the learned policy, and the planner in the same world


def draw_comparison(title: str, rows: Mapping[str, Pair]) -> Figure:
    """A row a policy: houses finished, T_90 and T_100; hollow: nearest_unknown in the same world.

    Bars are 95 % intervals of the mean; a house not finished counts as its max_steps.
    """
    with matplotlib.rc_context(STYLE):
        figure = new_figure(9.0, 1.5 + 0.38 * len(rows))
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        panels = figure.subplots(1, 1 + len(TIMES), sharey=True)
        _draw_finished(panels[0], rows)
        for axes, measure in zip(panels[1:], TIMES, strict=True):
            _draw_measure(axes, rows, measure)
        panels[0].set_yticks(range(len(rows)), list(rows))
        panels[0].invert_yaxis()
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        handles, labels = panels[-1].get_legend_handles_labels()
        figure.legend(
            handles, labels, frameon=False, fontsize=7, ncols=2, loc="outside lower right"
        )
        return figure


def _draw_finished(axes: Axes, rows: Mapping[str, Pair]) -> None:
    for place, pair in enumerate(rows.values()):
        learned, planner = (100 * entry["summary"]["T_100"]["reached"] for entry in pair)
        axes.plot(learned, place, "o", color=unit(ROBOTS[0]))
        axes.plot(planner, place, "o", color=unit(INK), fillstyle="none")
    axes.set_xlim(-3, 103)
    _label(axes, "houses finished, %")


def _draw_measure(axes: Axes, rows: Mapping[str, Pair], measure: str) -> None:
    for place, pair in enumerate(rows.values()):
        learned, planner = (entry["summary"][measure] for entry in pair)
        low, high = learned["ci95"]
        first = place == 0
        axes.plot([low, high], [place, place], color=unit(ROBOTS[0]), linewidth=1.5)
        axes.plot(
            learned["mean"], place, "o", color=unit(ROBOTS[0]), label="learned" if first else None
        )
        axes.plot(
            planner["mean"], place, "o", color=unit(INK), fillstyle="none",
            label=YARDSTICK if first else None,
        )  # fmt: skip
    axes.set_xlim(left=0)
    _label(axes, f"{measure}, steps")


def _label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left")
    axes.grid(axis="x", alpha=0.25, linewidth=0.5)
