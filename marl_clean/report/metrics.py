"""`metrics.csv`: what a run logged while it learnt.

The file has a column `frames` and one for each logged quantity, such as `train/loss` or
`validation/T_90`; a cell is empty where nothing was logged at that frame.
"""

import csv
from pathlib import Path

from marl_clean.errors import BadInput

FRAMES = "frames"
Series = list[tuple[float, float]]  # (frames, value)


def read_metrics(metrics: Path) -> dict[str, Series]:
    """Every column's points, empty cells left out. Raises BadInput without a column of frames."""
    try:
        with metrics.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise BadInput(f"{metrics}: cannot be read: {error.strerror}") from error
    except (ValueError, csv.Error) as error:
        raise BadInput(f"{metrics}: is no csv of numbers; a run's metrics.csv is valid") from error
    if not rows or FRAMES not in rows[0]:
        raise BadInput(f"{metrics}: needs a column {FRAMES} and at least one row of numbers")
    try:
        columns = {
            name: [(float(row[FRAMES]), float(row[name])) for row in rows if row[name]]
            for name in rows[0]
            if name != FRAMES
        }
    except (TypeError, ValueError) as error:
        raise BadInput(f"{metrics}: {error}; a run's metrics.csv is valid") from error
    return {name: points for name, points in columns.items() if points}
