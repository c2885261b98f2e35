"""Jobs of a second in place of trainings, for tests of what is around them.

Nothing is imported before it is used: Python reads this file whenever it starts.

`environment(folder)` makes every Python that is started with it train by `main` of this file: it
takes the lock, logs, resumes from its log, and leaves the files of a finished run. A journal beside
runs/ has a line for each begin and end.
"""

import os
import sys
import time
import types
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SECONDS, STEPS = "SHORT_JOB_SECONDS", 10
JOURNAL = Path("journal.txt")
BAD_SEED, DYING_SEED = 13, 14  # jobs that fail, and whose process dies


def install() -> None:
    """Put this stand-in where `marl_clean.commands.train` is."""
    stand_in = types.ModuleType("marl_clean.commands.train")
    stand_in.main = main
    sys.modules[stand_in.__name__] = stand_in


def train_by(monkeypatch: Any, **functions: Any) -> None:
    """Put `functions` in the place of `marl_clean.commands.train`, for one test."""
    import marl_clean.commands

    stand_in = types.ModuleType("marl_clean.commands.train")
    vars(stand_in).update(functions)
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    monkeypatch.setattr(marl_clean.commands, "train", stand_in, raising=False)


def environment(folder: Path, seconds: float = 1.0) -> dict[str, str]:
    """The environment of processes whose trainings are this stand-in."""
    folder.mkdir(parents=True, exist_ok=True)
    code = "from tests.reliability import short_jobs\nshort_jobs.install()\n"
    (folder / "sitecustomize.py").write_text(code)
    path = os.pathsep.join(map(str, [folder, ROOT]))
    return {**os.environ, "PYTHONPATH": path, SECONDS: str(seconds), "COLUMNS": "200"}


def note(event: str, name: str) -> None:
    """Add a line to the journal, whole: event, job, process."""
    with JOURNAL.open("a") as file:
        file.write(f"{event} {name} {os.getpid()}\n")


def main(config: Any, folder: Path, console: object = None) -> None:
    """Stand in for a training."""
    from omegaconf import OmegaConf

    from marl_clean.storage.lock import locked

    with locked(folder):
        note("begin", config.name)
        if config.seed == BAD_SEED:
            raise RuntimeError("thirteen")
        if config.seed == DYING_SEED:
            os.kill(os.getpid(), 9)
        (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
        metrics = folder / "metrics.csv"
        if not metrics.exists():
            metrics.write_text("frames,validation/T_90\n")
        frames = config.trainer.total_frames // STEPS
        while (done := metrics.read_text().count("\n") - 1) < STEPS:
            time.sleep(float(os.environ.get(SECONDS, "0")) / STEPS)
            with metrics.open("a") as file:
                file.write(f"{frames * (done + 1)},{100 - done}\n")
        finish(config, folder)
        note("end", config.name)


def finish(config: Any, folder: Path) -> None:
    """Leave what a finished run leaves; its numbers follow from its config's hash."""
    from omegaconf import OmegaConf

    from marl_clean.config.config_hash import config_hash
    from marl_clean.evaluation.records import make_entry, write_entries
    from marl_clean.storage import files, manifest

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    final = folder / manifest.FOLDER / f"final-{config.trainer.total_frames:012d}"
    final.parent.mkdir(exist_ok=True)
    contents = {manifest.TENSORS: [b"weights"], manifest.STATE: [b"{}"]}
    if not final.exists():
        files.write_folder(final, contents, manifest.MANIFEST, manifest.make_manifest)
    value = int(config_hash(config)[:4], 16)
    entries = [
        make_entry(config.name, "test", config_hash(config), 0.02, 2, houses(value)),
        make_entry("nearest_unknown", "test", config_hash(config), 0.0, 2, houses(50)),
    ]
    draw(config, folder)
    write_entries(folder / "evaluation.json", entries)


def draw(config: Any, folder: Path) -> None:
    """Stand in for the drawing of a run's pictures, without which it is not finished."""
    from marl_clean.commands.run_info import PICTURES
    from marl_clean.storage.pictures import WHOLE

    for name in PICTURES:
        (folder / name).write_bytes(b"".join(WHOLE[Path(name).suffix]))


def houses(value: int) -> list[dict]:
    """Records of three houses."""
    from marl_clean.evaluation.records import MEASURES

    record = {measure: 1.0 for measure in MEASURES if not measure.endswith("certify")}
    record |= {f"bound_{name}": 10 for name in ("90", "95", "99", "100")}
    record |= {"rows": 10, "cols": 10, "free_cells": 48, "max_steps": 1 << 17}
    return [
        record | {"seed": seed, "T_90": value + seed, "T_100": value + 2 * seed}
        for seed in range(3)
    ]
