"""`metrics.csv`: what a run logged while it learnt.

The file has a column `frames` and one for each logged quantity, such as `train/loss` or
`validation/T_90`; a cell is empty where nothing was logged at that frame.
"""

import csv
import io
from pathlib import Path

from marl_clean.errors import BadInput
from marl_clean.storage.reading import read_bytes

FRAMES = "frames"
LARGEST_BYTES, MOST_VALUES, MOST_COLUMNS = 32 << 20, 1_000_000, 1_000
LARGEST_NUMBER = 1e100  # no axis is that long; NaN is not below it, either
Series = list[tuple[float, float]]  # (frames, value)


def read_metrics(metrics: Path) -> dict[str, Series]:
    """Every column's points, without empty cells and numbers that no axis has room for.

    Raises BadInput without a column of frames, for other text and for more than a million numbers.
    """
    content = read_bytes(metrics, LARGEST_BYTES)
    if content.count(b",") + content.count(b"\n") > MOST_VALUES:
        raise BadInput(f"{metrics}: holds more than {MOST_VALUES:,} values")
    try:
        names, *rows = csv.reader(io.StringIO(content.decode("utf-8"), newline=""))
        place = names.index(FRAMES)
    except (ValueError, csv.Error) as error:
        raise BadInput(
            f"{metrics}: has no column {FRAMES}; a run's metrics.csv is valid"
        ) from error
    if len({*names}) < len(names) or len(names) > MOST_COLUMNS:
        raise BadInput(f"{metrics}: a column stands twice, or there are over {MOST_COLUMNS:,}")
    columns: dict[str, Series] = {name: [] for name in names if name != FRAMES}
    try:
        for row in filter(None, rows):
            frames = float(row[place])
            if not 0 <= frames < LARGEST_NUMBER:
                raise ValueError("frames are no number from 0 on")
            for name, text in zip(names, row, strict=False):
                if name != FRAMES and text and abs(value := float(text)) < LARGEST_NUMBER:
                    columns[name].append((frames, value))
    except (IndexError, ValueError) as error:
        raise BadInput(f"{metrics}: {str(error)[:80]}; a run's metrics.csv is valid") from error
    if not rows:
        raise BadInput(f"{metrics}: needs a column {FRAMES} and at least one row of numbers")
    return {name: points for name, points in columns.items() if points}
