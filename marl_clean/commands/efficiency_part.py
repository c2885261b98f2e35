"""How fast the rows of a comparison learn: validation measures over seeds against frames."""

import csv
import io
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from marl_clean.config.stored import METRICS
from marl_clean.errors import BadInput
from marl_clean.evaluation.efficiency import Curve, sample_efficiency
from marl_clean.evaluation.measured import Measured
from marl_clean.report.metrics import Series, read_metrics

VALIDATION = "validation/"
MEASURES = ("T_90", "T_100", "finished", "return")
EFFICIENCY = "efficiency.csv"
COLUMNS = ("row", "measure", "frames", "seeds", "iqm", "low", "high")
Curves = dict[str, dict[str, Curve]]
"""Of each row by its label, of each measure that its runs logged."""
log = logging.getLogger(__name__)


def validated(measured: Sequence[Measured]) -> dict[Path, dict[str, Series]]:
    """What each run logged on validation houses, by its folder and the measure.

    A damaged metrics.csv is logged in one line and left out; planners and exports have none.
    """
    curves: dict[Path, dict[str, Series]] = {}
    for folder in {item.folder: None for item in measured if item.folder is not None}:
        if not (folder / METRICS).is_file():
            continue
        try:
            columns = read_metrics(folder / METRICS)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        curves[folder] = {
            name.removeprefix(VALIDATION): points
            for name, points in columns.items()
            if name.startswith(VALIDATION)
        }
    return curves


def efficiency_of(
    measured: Sequence[Measured], logged: Mapping[Path, Mapping[str, Series]]
) -> Curves:
    """The curves of all rows, over the seeds of each; `logged`: what `validated` returned.

    A run that was measured in several sets of houses counts once.
    """
    runs: dict[str, dict[Path, Mapping[str, Series]]] = {}
    for item in measured:
        if item.label is not None and item.folder is not None and item.folder in logged:
            runs.setdefault(item.label, {})[item.folder] = logged[item.folder]
    curves: Curves = {}
    for label, of_seeds in runs.items():
        for measure in MEASURES:
            curve = sample_efficiency([run[measure] for run in of_seeds.values() if measure in run])
            if curve is not None:
                curves.setdefault(label, {})[measure] = curve
    return curves


def to_csv(curves: Curves) -> str:
    """A line for each row, measure and frame, with COLUMNS; `NA` where one seed has no interval."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    for label, measures in curves.items():
        for measure, curve in measures.items():
            for place, frame in enumerate(curve.frames):
                ends = [curve.value[place], curve.low[place], curve.high[place]]
                cells = ["NA" if np.isnan(end) else repr(float(end)) for end in ends]
                writer.writerow([label, measure, int(frame), int(curve.seeds[place]), *cells])
    return file.getvalue()
