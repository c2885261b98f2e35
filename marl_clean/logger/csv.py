"""metrics.csv: one row for every log interval, the same bytes for the same run."""

import csv
import io
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import final

from marl_clean.logger.base import CLOCK, Logger
from marl_clean.storage import files

FRAMES = "frames"
log = logging.getLogger(__name__)


@final
class Csv(Logger):
    """Write `metrics.csv`, one column per name, empty where a row has no value.

    Values that depend on the clock are left out. A new name adds a column, for which the file is
    rewritten; else rows are appended. The rows are a part of the run's state: a resumed run writes
    the file anew from it, whatever became of the file, and drops what was beyond the state.

    Args:
        folder: the run's.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "metrics.csv"
        self.rows: list[dict[str, str]] = []
        self.columns = [FRAMES]
        self.restored: str | None = None

    def state(self) -> str:
        return self._text()

    def restore(self, state: str) -> None:
        self.restored = state

    def resume(self, frames: int) -> None:
        self.rows, self.columns = [], [FRAMES]
        if frames:
            text = self._file_text() if self.restored is None else self.restored
            self.columns, rows = self._parsed(text)
            self.rows = [row for row in rows if int(row[FRAMES]) <= frames]
        self._write_all()

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        kept = {name: value for name, value in values.items() if not name.startswith(CLOCK)}
        row = {FRAMES: str(frames)} | {name: repr(value) for name, value in kept.items()}
        self.rows.append(row)
        new = [name for name in row if name not in self.columns]
        if new:
            self.columns += new
            self._write_all()
            return
        with files.writing(self.path), self.path.open("a", newline="", encoding="utf-8") as file:
            self._writer(file).writerow(row)

    def close(self) -> None:
        self._write_all()

    def _write_all(self) -> None:
        with files.writing(self.path):
            files.write_file(self.path, [self._text().encode()])

    def _text(self) -> str:
        text = io.StringIO(newline="")
        writer = self._writer(text)
        writer.writeheader()
        writer.writerows(self.rows)
        return text.getvalue()

    def _writer(self, file: io.TextIOBase) -> "csv.DictWriter[str]":
        return csv.DictWriter(file, self.columns, restval="", lineterminator="\n")

    def _file_text(self) -> str:
        """What the file holds, for a state of an earlier version, which has no rows."""
        try:
            return self.path.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            log.warning("%s: cannot be read: %s; begun anew", self.path, error.strerror)
            return f"{FRAMES}\n"

    def _parsed(self, text: str) -> tuple[list[str], list[dict[str, str]]]:
        """Columns and rows, but for damaged ones; of these a last one was torn by a kill."""
        header, *lines = csv.reader(text.replace("\0", "?").splitlines() or [""])
        if header[:1] != [FRAMES] or len({*header}) < len(header):
            log.warning("%s: its header is damaged; begun anew", self.path)
            return [FRAMES], []
        if lines and not _is_row(lines[-1], len(header)):
            lines.pop()
        whole = [line for line in lines if _is_row(line, len(header))]
        if len(whole) < len(lines):
            log.warning("%s: %d damaged rows left out", self.path, len(lines) - len(whole))
        return header, [dict(zip(header, line, strict=True)) for line in whole]


def _is_row(cells: list[str], columns: int) -> bool:
    """Whether a row is a number of frames, and a number or nothing in every other column."""
    if len(cells) != columns or not cells[0].isdecimal():
        return False
    try:
        for cell in filter(None, cells[1:]):
            float(cell)
    except ValueError:
        return False
    return True
