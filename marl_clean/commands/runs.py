"""`marl-clean runs`: what is in runs/, from what the folders show, without torch."""

import argparse
import fnmatch
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from marl_clean.commands.run_info import FAILED, RunInfo, State, look
from marl_clean.config.schema import choices
from marl_clean.config.stored import CONFIG, RUNS
from marl_clean.errors import BadInput
from marl_clean.storage import files, manifest
from marl_clean.storage.lock import LOCK, Held, locked

STATES = [state.value for state in State if state is not State.WAITING]
DEEPEST = 2  # folders around a run: runs/studies/STUDY/RUN
RESUMABLE = "state"  # the kind of checkpoints that a finished run needs no more
UNITS = (("d", 86400), ("h", 3600), ("min", 60), ("s", 1))
NONE = "-"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the filters and options of the command."""
    parser.add_argument(
        "patterns", metavar="PATTERN", nargs="*", help="of names, such as 'quick-*'"
    )
    parser.add_argument(
        "--state", action="append", help="running, finished, failed or unfinished; may be repeated"
    )
    parser.add_argument("--preset", action="append", help="of the runs; may be repeated")
    parser.add_argument(
        "--clean", action="store_true", help="remove what finished runs would resume from"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask")


def main(
    patterns: Sequence[str] = (),
    states: Sequence[str] = (),
    presets: Sequence[str] = (),
    clean: bool = False,
    yes: bool = False,
    console: Console | None = None,
) -> list[RunInfo]:
    """List the runs that pass all filters, or with `clean` remove finished ones' states.

    Raises BadInput on an unknown state, and where a question cannot be asked.
    """
    for state in states:
        if state not in STATES:
            raise BadInput(f"--state {state}: no such state; {choices(state, STATES)}")
    console = console or Console(width=max(Console().width, 120))
    infos = [info for info in every_run(RUNS) if passes(info, patterns, states, presets)]
    if clean:
        remove_states([info for info in infos if info.state is State.FINISHED], yes, console)
        return infos
    console.print(make_table(infos))
    console.print(f"{len(infos)} runs in {RUNS}/", highlight=False)
    return infos


def every_run(folder: Path, prefix: str = "") -> Iterator[RunInfo]:
    """Every run below `folder` by name, the jobs of named sweeps and studies included."""
    try:
        places = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    except OSError:
        return
    for place in places:
        name = f"{prefix}{place.name}"
        if any((place / mark).is_file() for mark in (CONFIG, FAILED, LOCK)):
            info = look(place, name)
            if info.state is not State.WAITING:
                yield info
        elif prefix.count("/") < DEEPEST:
            yield from every_run(place, f"{name}/")


def passes(
    info: RunInfo, patterns: Sequence[str], states: Sequence[str], presets: Sequence[str]
) -> bool:
    """Whether a run matches one of the patterns, states and presets; an empty list matches all."""
    return (
        (not patterns or any(fnmatch.fnmatchcase(info.name, pattern) for pattern in patterns))
        and (not states or info.state.value in states)
        and (not presets or info.preset in presets)
    )


def make_table(infos: Sequence[RunInfo]) -> Table:
    """A row a run: state, preset, seed, progress, score, size on disk, age."""
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("run", "state", "preset"):
        table.add_column(title, overflow="fold")
    for title in ("seed", "frames", "score", "x", "size", "age"):
        table.add_column(title, justify="right", no_wrap=True)
    for info in infos:
        score = info.score
        frames = f"{info.frames:,}"
        if info.total_frames is not None and info.state is not State.FINISHED:
            frames += f" of {info.total_frames:,}"
        cells = (
            info.name,
            info.state.value + (f": {info.reason}" if info.reason else ""),
            info.preset or NONE,
            NONE if info.seed is None else str(info.seed),
            frames,
            NONE if score is None else f"{score.measure} {score.mean:.1f}",
            NONE if score is None or score.of_planner is None else f"{score.of_planner:.2f}",
            size(bytes_in(info.folder)),
            age(time.time() - info.changed),
        )
        table.add_row(*map(Text, cells))
    return table


def remove_states(infos: Sequence[RunInfo], yes: bool, console: Console) -> None:
    """Remove what finished runs would resume from, after asking unless `yes`.

    Raises BadInput where there is no terminal to ask at.
    """
    states = {
        info.folder: paths
        for info in infos
        if (paths := manifest.paths(info.folder / manifest.FOLDER, RESUMABLE))
    }
    count = sum(map(len, states.values()))
    total = size(sum(bytes_in(path) for paths in states.values() for path in paths))
    what = f"{count} states of {len(states)} finished runs, {total}"
    if not states:
        console.print("finished runs have no states; nothing to remove")
        return
    if not yes:
        if not sys.stdin.isatty():
            raise BadInput(f"runs --clean: {what}: no terminal to ask at; add --yes")
        if console.input(f"remove {what}? [y/N] ", markup=False).strip().lower() not in (
            "y",
            "yes",
        ):
            console.print("nothing removed")
            return
    for folder, paths in states.items():
        try:
            with locked(folder):
                for final in manifest.paths(folder / manifest.FOLDER, "final")[:1]:
                    manifest.verify(final)
                    for path in reversed(paths):
                        files.remove_folder(path)
        except (Held, manifest.Damaged) as error:
            console.print(f"left as it is: {folder}: {error}", markup=False, soft_wrap=True)
    console.print(f"removed: {what}", highlight=False)


def bytes_in(folder: Path) -> int:
    """The size of all files in a folder, links not followed."""
    total = 0
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    total += bytes_in(Path(entry.path))
                else:
                    total += entry.stat(follow_symlinks=False).st_size
    except OSError:  # gone since
        pass
    return total


def size(count: int) -> str:
    """A number of bytes in units that people read."""
    amount = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if amount < 1000 or unit == "GB":
            break
        amount /= 1000
    return f"{amount:.0f} {unit}" if amount >= 10 or unit == "B" else f"{amount:.1f} {unit}"


def age(seconds: float) -> str:
    """A time span by its largest unit."""
    for unit, length in UNITS:
        if seconds >= length:
            return f"{int(seconds // length)} {unit}"
    return "0 s"
