"""Policies side by side: shares of houses finished and times, with their intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.env.viewer import INK, ROBOTS
from marl_clean.evaluation.paired import LEVEL
from marl_clean.evaluation.records import Entry, runs_of, sample, share_reached
from marl_clean.evaluation.table import YARDSTICK
from marl_clean.report.axes import STYLE, legend_below, new_figure, seeds_label, unit

TIMES = ("T_90", "T_100")
PANEL, CHARACTER = 2.35, 0.07  # inches: a panel as wide as its title, a letter of a row's name
BELOW = 0.22  # of the distance between rows: where the dots of seeds stand

Pair = tuple[Entry, Entry | None]  # the learned policy, and the planner in the same world


def draw_comparison(
    title: str, rows: Mapping[str, Pair], differences: Sequence[Mapping[str, Any]] = ()
) -> Figure:
    """One row per policy: houses finished, T_90, T_100; hollow: nearest_unknown in the same world.

    Bars are 95 % intervals of the mean, small dots the means of single seeds; a house not finished
    counts as its max_steps. With paired `differences` to one of the rows (`evaluation.paired`) all
    rows are of one world: times are then multiples of nearest_unknown's, where it was measured, and
    panels of differences follow.
    """
    planners = [planner for _, planner in rows.values()]
    relative = bool(differences) and None not in planners
    if differences:
        title += (
            f"\ndifferences on the same houses and seeds, reference: {differences[0]['reference']}"
        )
    with matplotlib.rc_context(STYLE):
        count = 1 + len(TIMES) * (2 if differences else 1)
        names = [seeds_label(name, entry.get("runs", 1)) for name, (entry, _) in rows.items()]
        width = PANEL * count + CHARACTER * max(map(len, names), default=0)
        figure = new_figure(width, 1.5 + 0.38 * len(rows))
        figure.suptitle(title, fontsize=9, x=0.01, ha="left")
        panels = figure.subplots(1, count, sharey=True)
        _draw_finished(panels[0], rows)
        for axes, measure in zip(panels[1:], TIMES, strict=False):
            _draw_measure(axes, rows, measure, relative)
        for axes, measure in zip(panels[1 + len(TIMES) :], TIMES, strict=False):
            _draw_differences(axes, list(rows), differences, measure)
        panels[0].set_yticks(range(len(rows)), names)
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        legend_below(figure, "right")
        return figure


def _draw_finished(axes: Axes, rows: Mapping[str, Pair]) -> None:
    for place, pair in enumerate(rows.values()):
        for entry, colour, style in zip(pair, (ROBOTS[0], INK), ("full", "none"), strict=True):
            if entry is not None:
                share = 100 * entry["summary"]["T_100"]["reached"]
                axes.plot(share, place, "o", color=unit(colour), fillstyle=style)
        shares = [100 * share_reached([run], "T_100") for run in runs_of(pair[0])]
        _draw_seeds(axes, shares, place)
    axes.set_xlim(-3, 103)
    _label(axes, "houses finished, %")


def _draw_measure(
    axes: Axes, rows: Mapping[str, Pair], measure: str, relative: bool = False
) -> None:
    """A time's mean and interval beside the planner's, or as multiples of it."""
    for place, pair in enumerate(rows.values()):
        learned, planner = (entry and entry["summary"][measure] for entry in pair)
        assert learned is not None
        unit_steps = planner["mean"] if relative and planner else 1.0
        low, high = (end / unit_steps for end in learned["ci95"])
        first = place == 0
        axes.plot([low, high], [place, place], color=unit(ROBOTS[0]), linewidth=1.5)
        axes.plot(
            learned["mean"] / unit_steps, place, "o", color=unit(ROBOTS[0]),
            label="learned" if first else None,
        )  # fmt: skip
        means = [float(np.nanmean(sample([run], measure))) for run in runs_of(pair[0])]
        _draw_seeds(axes, [mean / unit_steps for mean in means], place)
        if planner is not None:
            axes.plot(
                planner["mean"] / unit_steps, place, "o", color=unit(INK), fillstyle="none",
                label=YARDSTICK if first else None,
            )  # fmt: skip
    axes.set_xlim(left=0)
    _label(axes, f"{measure} / {YARDSTICK}'s" if relative else f"{measure}, steps")


def _draw_seeds(axes: Axes, values: Sequence[float], place: int) -> None:
    """A dot for each seed, below the row's interval."""
    label = "a seed" if place == 0 else None
    axes.plot(
        values, [place + BELOW] * len(values), ".", color=unit(ROBOTS[0]), markersize=4, alpha=0.6,
        label=label,
    )  # fmt: skip


def _draw_differences(
    axes: Axes, labels: Sequence[str], differences: Sequence[Mapping[str, Any]], measure: str
) -> None:
    """Paired differences of a time, in steps; filled where p < 0.05 before correction."""
    axes.axvline(0, color=unit(INK), linewidth=0.8)
    for difference in differences:
        place, result = labels.index(difference["row"]), difference[measure]
        if result["mean"] is None:
            continue
        axes.plot(result["ci95"], [place, place], color=unit(ROBOTS[1]), linewidth=1.5)
        significant = result["p"] < LEVEL
        axes.plot(
            result["mean"], place, "o", color=unit(ROBOTS[1]),
            fillstyle="full" if significant else "none",
            label="p < 0.05, uncorrected" if significant else "may be chance",
        )  # fmt: skip
    _label(axes, f"{measure} minus reference's, steps")


def _label(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left")
    axes.grid(axis="x", alpha=0.25, linewidth=0.5)
