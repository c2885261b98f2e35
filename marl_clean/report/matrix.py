"""Trained over one channel, measured over another: a matrix of times."""

from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from marl_clean.evaluation.records import Entry
from marl_clean.report.axes import STYLE, new_figure

MEASURE = "T_90"


def draw_matrix(cells: Mapping[tuple[str, str], Entry]) -> Figure:
    """One cell per (trained over, measured over): mean T_90, darker is slower."""
    rows = list(dict.fromkeys(row for row, _ in cells))
    columns = list(dict.fromkeys(column for _, column in cells))
    means = np.array(
        [[cells[row, column]["summary"][MEASURE]["mean"] for column in columns] for row in rows]
    )
    with matplotlib.rc_context(STYLE):
        figure = new_figure(2.5 + 1.1 * len(columns), 1.4 + 0.55 * len(rows))
        axes = figure.subplots()
        image = axes.imshow(means, cmap="Blues", aspect="auto", vmin=0.8 * means.min())
        middle = (means.min() + means.max()) / 2
        for (row, column), mean in np.ndenumerate(means):
            colour = "white" if mean > middle else "black"
            axes.text(column, row, f"{mean:.1f}", ha="center", va="center", color=colour)
        axes.set_xticks(range(len(columns)), columns, rotation=20, ha="right")
        axes.set_yticks(range(len(rows)), rows)
        axes.set(xlabel="measured over", ylabel="trained over")
        axes.spines[:].set_visible(False)
        figure.colorbar(image, label=f"{MEASURE}, steps", shrink=0.9)
        return figure
