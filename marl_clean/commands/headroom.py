"""`marl-clean headroom`: what maps and targets of others are worth, before anything is trained."""

import csv
import hashlib
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from marl_clean.commands._headroom_settings import Plan, make_plan
from marl_clean.commands._progress import EvaluationProgress
from marl_clean.commands.checks import check_out
from marl_clean.commands.command_line import command_line
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput
from marl_clean.evaluation.headroom import WIDTH, Played, advice, make_headroom_table, rows_of
from marl_clean.storage import files

FOLDER = "headroom"

OnProgress = Callable[[str, float], object]


def run(texts: Sequence[str], console: Console | None = None) -> list[dict[str, Any]]:
    """Play the grid, print its table, and write rows and heat map; return the rows.

    `out=FILE.json` says where; default: runs/headroom/<hash of the grid>/headroom.json. A csv and
    the figure, svg and png, have the same name beside it. Raises BadInput before anything is
    played where a setting is wrong, and where nothing can be written.
    """
    plan = make_plan(texts)
    path = path_of(plan)
    check_out(path)
    console = console or Console(width=max(Console().width, WIDTH))
    with EvaluationProgress(len(plan.plays)) as progress:
        rows = measured(plan, progress.show)
    console.print(make_headroom_table(rows))
    console.print(advice(rows))
    for written in (*write_rows(path, rows), *draw(path, rows, plan)):
        console.print(f"written to {written}", soft_wrap=True)
    return rows


def path_of(plan: Plan) -> Path:
    """Where the rows are written."""
    if plan.config.out is not None:
        return Path(plan.config.out)
    hashes = " ".join(config_hash(play.config) for play in plan.plays)
    return RUNS / FOLDER / hashlib.sha256(hashes.encode()).hexdigest()[:8] / "headroom.json"


def measured(plan: Plan, on_progress: OnProgress | None = None) -> list[dict[str, Any]]:
    """Every play of a plan as a row."""
    from marl_clean.evaluation.planner_play import one_thread, play

    plays = []
    for planned in plan.plays:

        def show(share: float, label: str = planned.label) -> None:
            if on_progress is not None:
                on_progress(label, share)

        with one_thread():
            records = play(planned.config, show)
        plays.append(Played(planned.cell, planned.memory, planned.assignment, records))
    return rows_of(plays)


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> list[Path]:
    """Write the rows as json and csv. Raises BadInput where they cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    as_json = json.dumps(rows, indent=1, allow_nan=False) + "\n"
    texts = {path: as_json, path.with_suffix(".csv"): text.getvalue()}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for place, content in texts.items():
            files.write_file(place, [content.encode()])
    except OSError as error:
        raise BadInput(f"out={path}: cannot be written: {error.strerror}") from error
    return list(texts)


def draw(path: Path, rows: Sequence[dict[str, Any]], plan: Plan) -> list[Path]:
    """Draw the heat map beside the rows."""
    from marl_clean.report.axes import save_figure
    from marl_clean.report.headroom import draw_headroom
    from marl_clean.report.origin import Origin

    origin = Origin(command_line(), [config_hash(plan.config)])
    return save_figure(draw_headroom(rows), path.with_suffix(""), origin)
