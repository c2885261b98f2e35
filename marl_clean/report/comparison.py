"""Several policies beside each other: shares finished and times, with their intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.evaluation.records import Entry
from marl_clean.evaluation.table import YARDSTICK
from marl_clean.report.axes import STYLE, new_figure, unit
from marl_clean.viewer import INK, ROBOTS

TIMES = ("T_90", "T_100")

Pair = tuple[Entry, Entry | None]  # the learned policy, and the planner in the same world


def draw_comparison(
    title: str, rows: Mapping[str, Pair], differences: Sequence[Mapping[str, Any]] = ()
) -> Figure:
    """A row a policy: houses finished, T_90 and T_100; hollow: nearest_unknown in the same world.

    Bars are 95 % intervals of the mean; a house not finished counts as its max_steps. With paired
    `differences` to one of the rows (`evaluation.paired`) a last panel shows those of T_90.
    """
    with matplotlib.rc_context(STYLE):
        figure = new_figure(11.5 if differences else 9.0, 1.5 + 0.38 * len(rows))
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        panels = figure.subplots(1, 1 + len(TIMES) + bool(differences), sharey=True)
        _draw_finished(panels[0], rows)
        for axes, measure in zip(panels[1:], TIMES, strict=False):
            _draw_measure(axes, rows, measure)
        if differences:
            _draw_differences(panels[-1], list(rows), differences)
        panels[0].set_yticks(range(len(rows)), list(rows))
        panels[0].invert_yaxis()
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        handles, labels = panels[len(TIMES)].get_legend_handles_labels()
        figure.legend(
            handles, labels, frameon=False, fontsize=7, ncols=2, loc="outside lower right"
        )
        return figure


def _draw_finished(axes: Axes, rows: Mapping[str, Pair]) -> None:
    for place, pair in enumerate(rows.values()):
        for entry, colour, style in zip(pair, (ROBOTS[0], INK), ("full", "none"), strict=True):
            if entry is not None:
                share = 100 * entry["summary"]["T_100"]["reached"]
                axes.plot(share, place, "o", color=unit(colour), fillstyle=style)
    axes.set_xlim(-3, 103)
    _label(axes, "houses finished, %")


def _draw_measure(axes: Axes, rows: Mapping[str, Pair], measure: str) -> None:
    for place, pair in enumerate(rows.values()):
        learned, planner = (entry and entry["summary"][measure] for entry in pair)
        assert learned is not None
        low, high = learned["ci95"]
        first = place == 0
        axes.plot([low, high], [place, place], color=unit(ROBOTS[0]), linewidth=1.5)
        axes.plot(
            learned["mean"], place, "o", color=unit(ROBOTS[0]), label="learned" if first else None
        )
        if planner is None:
            continue
        axes.plot(
            planner["mean"], place, "o", color=unit(INK), fillstyle="none",
            label=YARDSTICK if first else None,
        )  # fmt: skip
    axes.set_xlim(left=0)
    _label(axes, f"{measure}, steps")


def _draw_differences(
    axes: Axes, labels: Sequence[str], differences: Sequence[Mapping[str, Any]]
) -> None:
    """Paired differences of T_90; filled where it holds after correction for several."""
    axes.axvline(0, color=unit(INK), linewidth=0.8)
    for one in differences:
        place, found = labels.index(one["row"]), one["T_90"]
        if found["mean"] is None:
            continue
        axes.plot(found["ci95"], [place, place], color=unit(ROBOTS[1]), linewidth=1.5)
        style = "full" if found["p_holm"] < 0.05 else "none"
        axes.plot(found["mean"], place, "o", color=unit(ROBOTS[1]), fillstyle=style)
    _label(axes, f"T_90 minus that of {differences[0]['reference']}")


def _label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left")
    axes.grid(axis="x", alpha=0.25, linewidth=0.5)
