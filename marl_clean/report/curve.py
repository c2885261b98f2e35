"""`curve.png`: how a run learnt, from its metrics.csv.

Columns with the same last name share a panel.
"""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from marl_clean.env.viewer import INK
from marl_clean.report.axes import STYLE, legend_below, new_figure, row_style, unit
from marl_clean.report.metrics import FRAMES, Series, read_metrics
from marl_clean.report.origin import Origin
from marl_clean.storage import files

FIRST = ("finished", "T_90", "T_100", "coverage", "return", "redundancy", "loss", "epsilon")
RIVAL = "nearest_unknown"
TRAINING = "training"  # where a column's name has no first part
VALIDATION = "validation"
RIVAL_DASHES = (0, (1, 2))
LEGEND_INCHES = 0.25
MOST_PANELS = 8
PANELS_A_ROW = 4
FEW = 40  # with at most so many points, each gets a mark


def draw_curve(
    metrics: Path, path: Path, origin: Origin, rival: Mapping[str, float] | None = None
) -> None:
    """Draw `metrics` into the picture `path`, with a rival's means as horizontal lines.

    `rival` holds nearest_unknown's means by the names of the measures. Raises BadInput where
    there is nothing to draw.
    """
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure = plot_curve(read_metrics(metrics), rival or {})
        figure.savefig(content, dpi=150, format="png", metadata=origin.metadata())
    with files.writing(path):
        files.write_file(path, [content.getvalue()])


def plot_curve(columns: Mapping[str, Series], rival: Mapping[str, float]) -> Figure:
    """One panel per quantity, the most informative first; one legend below all of them."""
    shown = panels(list(columns))[:MOST_PANELS]
    rows = -(-len(shown) // PANELS_A_ROW)
    kinds = [TRAINING, VALIDATION, *map(kind_of, columns)]
    styles = {kind: row_style(index) for index, kind in enumerate(dict.fromkeys(kinds))}
    figure = new_figure(2.6 * min(len(shown), PANELS_A_ROW), 2.2 * rows + LEGEND_INCHES)
    axes = figure.subplots(rows, min(len(shown), PANELS_A_ROW), squeeze=False).flatten()
    for panel, name in zip(axes, shown, strict=False):
        own = {key: columns[key] for key in columns if last(key) == name}
        _plot_panel(panel, name, own, styles)
        if name in rival:
            panel.axhline(
                rival[name], color=unit(INK), linestyle=RIVAL_DASHES, linewidth=1.2, label=RIVAL
            )
    for panel in axes[len(shown) :]:
        panel.set_axis_off()
    legend_below(figure, "center")
    return figure


def panels(names: Sequence[str]) -> list[str]:
    """The distinct last names: those in FIRST, in its order, then the others in theirs."""
    distinct = list(dict.fromkeys(map(last, names)))
    return [name for name in FIRST if name in distinct] + [n for n in distinct if n not in FIRST]


def last(name: str) -> str:
    """What a column measures: `T_90` of `validation/T_90`."""
    return name.rpartition("/")[2]


def kind_of(name: str) -> str:
    """When a column was measured: `validation` of `validation/T_90`."""
    return name.rpartition("/")[0] or TRAINING


def _plot_panel(
    axes: Axes, title: str, columns: Mapping[str, Series], styles: Mapping[str, dict[str, Any]]
) -> None:
    for name, points in columns.items():
        frames, values = zip(*points, strict=True)
        kind = kind_of(name)
        mark = "." if len(points) <= FEW else None
        axes.plot(frames, values, marker=mark, linewidth=1.2, label=kind, **styles[kind])
    axes.set_title(title, loc="left")
    axes.set_xlabel(FRAMES)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.grid(alpha=0.25, linewidth=0.5)
