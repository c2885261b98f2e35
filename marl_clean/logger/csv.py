"""metrics.csv: one row for every log interval, the same bytes for the same run."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import final

from marl_clean.logger.base import CLOCK, Logger
from marl_clean.storage import files

FRAMES = "frames"


@final
class Csv(Logger):
    """Write `metrics.csv`, one column per name, empty where a row has no value.

    Values that depend on the clock are left out. A new name adds a column, for which the file is
    rewritten; else rows are appended. What an interrupted run wrote beyond its checkpoint is
    dropped when it resumes.

    Args:
        folder: the run's.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "metrics.csv"
        self.rows: list[dict[str, str]] = []
        self.columns = [FRAMES]

    def resume(self, frames: int) -> None:
        self.rows, self.columns = [], [FRAMES]
        if frames and self.path.is_file():
            with self.path.open(newline="", encoding="utf-8") as file:
                reader = csv.DictReader(file)
                self.columns = list(reader.fieldnames or [FRAMES])
                complete = (row for row in reader if None not in row.values())
                self.rows = [row for row in complete if int(row[FRAMES]) <= frames]
        self._write_all()

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        kept = {name: value for name, value in values.items() if not name.startswith(CLOCK)}
        row = {FRAMES: str(frames)} | {name: repr(value) for name, value in kept.items()}
        self.rows.append(row)
        new = [name for name in row if name not in self.columns]
        if new:
            self.columns += new
            self._write_all()
        else:
            with self.path.open("a", newline="", encoding="utf-8") as file:
                self._writer(file).writerow(row)

    def close(self) -> None:
        self._write_all()

    def _write_all(self) -> None:
        text = io.StringIO(newline="")
        writer = self._writer(text)
        writer.writeheader()
        writer.writerows(self.rows)
        files.write_file(self.path, [text.getvalue().encode()])

    def _writer(self, file: io.TextIOBase) -> "csv.DictWriter[str]":
        return csv.DictWriter(file, self.columns, restval="", lineterminator="\n")
