"""What a run's folder says of itself: its state, how far it is, its score. Without torch.

`look` is cheap, so that a thousand runs are listed in a moment; `is_finished` verifies.
"""

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from marl_clean.config.compose import has_houses
from marl_clean.config.stored import CONFIG, METRICS
from marl_clean.errors import BadInput
from marl_clean.storage import manifest
from marl_clean.storage.lock import Holder, holder
from marl_clean.storage.pictures import is_whole
from marl_clean.storage.reading import DECODER, parse_json, read_bytes

MEASURED, PICTURES = "evaluation.json", ("curve.png", "replay.gif")
FAILED, LOG = "failed.txt", "job.log"  # of a job of a sweep: why it failed, and what it printed
YARDSTICK = "nearest_unknown"
SCORES = ("T_90", "return")  # the first that was measured is a run's score
NAMED_BY_HASH = re.compile(r"(.+)-[0-9a-f]{8}")
LONGEST_LINE = 300
LARGEST_BYTES = 64 << 20  # of a result file
LARGEST_SCORE = 1e15  # or a line of the list has 300 digits


class State(Enum):
    """What can be said of a run from outside."""

    RUNNING = "running"
    FINISHED = "finished"
    FAILED = "failed"
    UNFINISHED = "unfinished"
    WAITING = "waiting"  # there is nothing of it yet


@dataclass(frozen=True)
class Score:
    """A run's measure on its own test houses, and as a multiple of the planner's."""

    measure: str
    mean: float
    of_planner: float | None


@dataclass(frozen=True)
class RunInfo:
    """One run, as its folder shows it.

    Attributes:
        name: of the folder, below runs/.
        preset: that its name begins with; None where the name was given.
        seed, total_frames: of its config.
        frames: logged so far.
        reason: of a failed run, in one line.
        holder: the process that trains it.
        changed: when anything in it was last written, in seconds since 1970.
    """

    name: str
    folder: Path
    state: State
    preset: str | None = None
    seed: int | None = None
    frames: int = 0
    total_frames: int | None = None
    score: Score | None = None
    reason: str | None = None
    holder: Holder | None = None
    changed: float = 0.0


def look(folder: Path, name: str) -> RunInfo:
    """What the folder of the run `name` shows; nothing in it needs to be whole."""
    if not folder.is_dir():
        return RunInfo(name, folder, State.WAITING)
    other = holder(folder)
    finals = manifest.paths(folder / manifest.FOLDER, "final")
    score = score_of(folder) if finals and not other else None
    reason = first_line(folder / FAILED)
    if other is not None:
        state = State.RUNNING
    elif finals and score is not None:
        state = State.FINISHED
    elif reason is not None:
        state = State.FAILED
    else:
        state = State.UNFINISHED if (folder / CONFIG).is_file() else State.WAITING
    config = _text(folder / CONFIG)
    by_hash = NAMED_BY_HASH.fullmatch(name)
    return RunInfo(
        name,
        folder,
        state,
        preset=by_hash[1] if by_hash else None,
        seed=_number(r"^seed: (\d{1,19})\s*$", config),
        frames=int(finals[0].name.rpartition("-")[2]) if finals else last_frames(folder),
        total_frames=_number(r"^  total_frames: (\d{1,19})\s*$", config),
        score=score,
        reason=reason if state is State.FAILED else None,
        holder=other,
        changed=changed(folder),
    )


def is_finished(config: DictConfig, folder: Path) -> bool:
    """Whether nothing is left to do: weights and result file verify, and the pictures are drawn."""
    from marl_clean.evaluation.records import read_entries

    pictures = PICTURES if has_houses(config) else PICTURES[:1]
    if not all(is_whole(folder / name) for name in pictures):
        return False
    if not manifest.paths(folder / manifest.FOLDER, "final"):
        return False
    try:
        manifest.weights_sha256(folder)
        entries = read_entries(folder / MEASURED)
    except BadInput:
        return False
    return any(entry["policy"] == config.name for entry in entries)


def score_of(folder: Path) -> Score | None:
    """The score in a run's result file, in which the run's own houses come first; or None."""
    try:
        own, *others = _summaries(read_bytes(folder / MEASURED, LARGEST_BYTES).decode("utf-8"))
        same = ("house_set", "n_agents")
        planners: Iterator[dict[str, Any]] = (
            entry["summary"]
            for entry in others
            if entry["policy"] == YARDSTICK and all(entry[key] == own[key] for key in same)
        )
        measure = next(name for name in SCORES if name in own["summary"])
        mean = float(own["summary"][measure]["mean"])
        if abs(mean) >= LARGEST_SCORE:
            return None
        if measure == "return" or (planner := next(planners, None)) is None:
            return Score(measure, mean, None)
        return Score(measure, mean, mean / planner[measure]["mean"])
    except (ArithmeticError, ValueError, LookupError, TypeError, RecursionError, StopIteration):
        return None


def _summaries(text: str) -> Iterator[dict[str, Any]]:
    """The entries of an evaluation.json without their houses, which are nearly all of it.

    The file is read by its indentation, as this package writes it; another is read as JSON.
    """
    if not text.startswith('[\n {\n  "'):
        yield from parse_json(text.encode("utf-8"))
        return
    for block in text[1:].split("\n {\n")[1:]:
        head = dict(re.findall(r'^  "(\w+)": ("[^\n]*"|\d+),$', block[:2000], re.M))
        start = block.index('\n  "summary": ') + len('\n  "summary": ')
        entry = {name: json.loads(value) for name, value in head.items()}
        yield entry | {"summary": DECODER.raw_decode(block, start)[0]}


def last_frames(folder: Path) -> int:
    """The frames of the last whole row of a run's log; 0 without one."""
    try:
        with (folder / METRICS).open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - 8192))
            text = file.read().decode(errors="replace")
    except OSError:
        return 0
    for line in reversed(text.rpartition("\n")[0].splitlines()):
        if (first := line.partition(",")[0]).isdecimal():
            return int(first)
    return 0


def last_validation(folder: Path) -> tuple[str, float] | None:
    """The score on validation houses when it was last measured: its name and value."""
    try:
        with (folder / METRICS).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        for row in reversed(rows):
            for measure in SCORES:
                if row.get(f"validation/{measure}"):
                    return measure, float(row[f"validation/{measure}"])
    except (OSError, ValueError, csv.Error):
        pass
    return None


def changed(folder: Path) -> float:
    """When a file right in the folder was last written, in seconds since 1970."""
    times = [0.0]
    for path in folder.iterdir():
        try:
            times.append(path.stat().st_mtime)
        except OSError:  # gone since
            continue
    return max(times)


def first_line(path: Path) -> str | None:
    """The first line of a file; None without one."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline(LONGEST_LINE).strip() or None
    except OSError:
        return None


def _text(path: Path) -> str:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.read(1 << 20)
    except OSError:
        return ""


def _number(pattern: str, text: str) -> int | None:
    match = re.search(pattern, text, re.M)
    return int(match[1]) if match else None
