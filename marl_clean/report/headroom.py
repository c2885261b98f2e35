"""The heat map of `marl-clean headroom`: what maps and targets of others are worth."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from marl_clean.evaluation.headroom import ASSIGNED, is_gain, merged_cells, row_in
from marl_clean.report.axes import STYLE, new_figure

Row = Mapping[str, Any]
WORTH = {
    "maps": "T_90 with private maps / with maps merged in contact",
    "targets": "T_90 with merged maps, no assignment / the better assignment of targets",
}


def draw_headroom(rows: Sequence[Row]) -> Figure:
    """Panels by number of robots; above what maps are worth, below what targets are.

    Houses by reach, one colour scale from 1 up; a factor whose interval reaches 1 in brackets.
    """
    cells = merged_cells(rows)
    teams = list(dict.fromkeys(cell["n_agents"] for cell in cells))
    houses = list(dict.fromkeys(cell["house"] for cell in cells))
    ranges = list(dict.fromkeys((cell["reach"], cell["channel"]) for cell in cells))
    several = len({channel for _, channel in ranges}) > 1
    names = [f"{reach}\n{channel}" if several else str(reach) for reach, channel in ranges]
    drawn = {kind: [_panel(rows, kind, team, houses, ranges) for team in teams] for kind in WORTH}
    factors = [values for panels in drawn.values() for values, _ in panels]
    most = max(1.1, *(float(np.nanmax(values)) for values in factors))
    with matplotlib.rc_context(STYLE):
        width = 1.6 + len(teams) * (0.5 + 0.62 * len(ranges))
        figure = new_figure(max(6.4, width), 1.6 + 2 * (0.6 + 0.3 * len(houses)))
        parts = figure.add_gridspec(2, 1)
        for index, (kind, title) in enumerate(WORTH.items()):
            part = figure.add_subfigure(parts[index])
            part.suptitle(title, fontsize=9, x=0.01, ha="left")
            panels = part.subplots(1, len(teams), sharey=True, squeeze=False)[0]
            for axes, team, (values, clear) in zip(panels, teams, drawn[kind], strict=True):
                axes.imshow(values, cmap="Blues", aspect="auto", vmin=1, vmax=most)
                _write(axes, values, clear, 1 + 0.6 * (most - 1))
                axes.set_title(f"{team} robots", loc="left")
                axes.set_xticks(range(len(names)), names)
                axes.set_yticks(range(len(houses)), houses)
                axes.spines[:].set_visible(False)
                axes.tick_params(length=0)
                if index == 1:
                    axes.set_xlabel("reach, cells")
            scale = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(1, most), "Blues")
            part.colorbar(scale, ax=list(panels), label="times sooner", shrink=0.9)
        return figure


def _panel(
    rows: Sequence[Row],
    kind: str,
    team: int,
    houses: Sequence[str],
    ranges: Sequence[tuple[Any, Any]],
) -> tuple[Float[np.ndarray, "house range"], list[list[bool]]]:
    """The factors, and whether each lies clearly above 1."""
    values = np.full((len(houses), len(ranges)), np.nan)
    clear = [[False for _ in ranges] for _ in houses]
    for place, house in enumerate(houses):
        for column, (reach, channel) in enumerate(ranges):
            cell = {"house": house, "n_agents": team, "reach": reach, "channel": channel}
            names = ("none",) if kind == "maps" else ASSIGNED
            factor = "T_90_headroom" if kind == "maps" else "T_90_coordination"
            choices = [row_in(rows, cell, "merged", name) for name in names]
            best = max(choices, key=lambda row: row[factor] or 0.0)
            values[place, column] = np.nan if best[factor] is None else best[factor]
            clear[place][column] = is_gain(best, factor)
    return values, clear


def _write(
    axes: Axes, values: Float[np.ndarray, "house range"], clear: list[list[bool]], middle: float
) -> None:
    for (place, column), value in np.ndenumerate(values):
        if np.isnan(value):
            continue
        text = f"{value:.2f}" if clear[place][column] else f"({value:.2f})"
        colour = "white" if value > middle else "black"
        axes.text(column, place, text, ha="center", va="center", color=colour, fontsize=7.5)
