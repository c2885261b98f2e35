"""Every format of files that a stranger may hand over: a whole file, and the reader of commands."""

import base64
import csv
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import yaml
from tensordict import TensorDict
from torch import nn

from marl_clean.commands import frozen, study_plan
from marl_clean.commands.gathering import gather, measured_of, of_folder, read_export, rows_of
from marl_clean.commands.run_info import look
from marl_clean.commands.run_record import earlier_processes
from marl_clean.config.compose import checked, compose_config
from marl_clean.config.stored import load_config
from marl_clean.evaluation.intervened import read_intervened
from marl_clean.evaluation.marl_eval import to_marl_eval
from marl_clean.evaluation.table import make_table
from marl_clean.evaluation.tidy import to_tidy
from marl_clean.house.base import draw_houses
from marl_clean.house.drawn import Drawn
from marl_clean.house.floorplan import FloorPlan
from marl_clean.report.metrics import read_metrics
from marl_clean.report.recorded import read_recording
from marl_clean.storage import files
from marl_clean.storage.checkpoint import FOLDER, Checkpoints, fit_weights, load_weights
from marl_clean.storage.manifest import MANIFEST, STATE, TENSORS, count_weights, make_manifest
from marl_clean.storage.safe_yaml import Plain
from marl_clean.trainer._first_updates import FirstUpdates
from marl_clean.trainer._first_updates import read as read_first_updates
from tests.commands.test_compare import write_run
from tests.commands.test_study import STUDY
from tests.house.test_mutations import ORIGINALS as PLANS

BEST, KEPT = "best-000000000002", "state-000000000002"


@dataclass(frozen=True)
class Format:
    """A file at `path` in the folder that `make` fills, and what reads it as the commands do.

    `seal` makes digests hold again that are kept of the file, as a stranger can. `binary`: numbers
    and brackets in it are no text; `headed`: it begins with the length of a header, which is JSON.
    """

    path: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]
    seal: Callable[[Path], object] | None = None
    binary: bool = False
    headed: bool = False


def network() -> nn.Module:
    return nn.Sequential(nn.Linear(60, 8), nn.Linear(8, 2))


def make_checkpoint(folder: Path) -> None:
    checkpoints = Checkpoints(folder / FOLDER)
    checkpoints.save("best", 2, network().state_dict(), {"T_90": 40.5})
    tree = {
        "counters": {"frames": 2, "updates": 1},
        "adam": {0: {"step": torch.tensor(3.0)}, "groups": [{"betas": (0.9, 0.999)}]},
        "nothing": None,
        "carried": TensorDict({"agents": TensorDict({"x": torch.ones(2, 3, 1)}, [2, 3])}, [2]),
    }
    checkpoints.save("state", 2, tree, {})


def seal_checkpoints(folder: Path) -> None:
    for checkpoint in (folder / FOLDER).iterdir():
        digests = {name: files.digest_of(checkpoint / name) for name in (TENSORS, STATE)}
        (checkpoint / MANIFEST).write_bytes(make_manifest(digests))


def read_weights(folder: Path) -> None:
    count_weights(folder)
    own = network()
    fit_weights(own, load_weights(folder, own).tree, folder)


def read_state(folder: Path) -> None:
    Checkpoints(folder / FOLDER).newest("state")


def make_run(folder: Path) -> None:
    write_run(folder / "plan-s0", ["seed=0"], [40, 60, None, 20])


def read_measured(folder: Path) -> None:
    """As `compare`, `runs` and `report` do, until the tables."""
    make_table([item.entry for item in of_folder(folder / "plan-s0")])
    read_intervened(folder / "plan-s0" / "evaluation.json")


def read_look(folder: Path) -> None:
    """As `runs` does, which shows what it can of a run that is not whole."""
    checkpoints = Checkpoints(folder / "plan-s0" / FOLDER)
    if not checkpoints.folder.exists():
        checkpoints.save("final", 9, {"x": torch.ones(1)}, {})
    look(folder / "plan-s0", "plan-s0")


def make_metrics(folder: Path) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["frames", "train/loss", "validation/T_90", "validation/T_100"])
    for row in range(1, 40):
        writer.writerow([row * 500, 1 / row, 90 - row if row % 2 else "", 95.5 - row])
    (folder / "metrics.csv").write_text(text.getvalue())


def make_record(folder: Path) -> None:
    process = {
        "command": "marl-clean train comm=plan",
        "began": "2026-01-01T00:00:00+00:00",
        "ended": "finished",
        "wall_seconds": 61.5,
        "cpu_joules": None,
        "code": {"marl_clean": {"version": "0.1.0", "commit": None, "clean": None}},
        "versions": {"python": "3.11.7", "torch": "2.13.0"},
        "hardware": {"cpu": "a processor", "cores": 2, "memory_gib": 16.0, "gpu": None},
    }
    record = {"schema": 1, "name": "a", "config_sha256": "0" * 64, "seed": 0}
    text = json.dumps(record | {"processes": [process, process]}, indent=1)
    (folder / "run.json").write_text(text)


def read_record(folder: Path) -> None:
    """As a resumed run does, which writes what it read back."""
    json.dumps(earlier_processes(folder / "run.json"), indent=1, allow_nan=False)


def make_first_updates(folder: Path) -> None:
    first, own = FirstUpdates(folder), network()
    for block in (1, 2, 3):
        first.note(64 * block, block, own)


def make_plan(suffix: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / "apartment.pgm").write_bytes(PLANS[".pgm"])
        (folder / f"plan{suffix}").write_bytes(PLANS[suffix])

    return make


def read_plan(suffix: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        path = str(folder / f"plan{suffix}")
        house = Drawn(path) if suffix == ".txt" else FloorPlan(path)
        return draw_houses(house, [0], n_agents=2)

    return read


def make_exports(folder: Path) -> None:
    runs = folder / "of"
    runs.mkdir()
    names = [write_run(runs / f"plan-s{seed}", [f"seed={seed}"], [40, None]) for seed in (0, 1)]
    [(key, world)] = gather(names).items()
    measured = measured_of(key, world, rows_of(world))
    (folder / "tidy.csv").write_text(to_tidy(measured))
    (folder / "marl_eval.json").write_text(to_marl_eval(measured, {}))


def read_exported(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        entries = [item.entry for item in read_export(folder / name)]
        if entries:
            make_table(entries)

    return read


def make_study(folder: Path) -> None:
    configs = {
        arm: [compose_config([*settings, f"seed={seed}"]) for seed in STUDY["seeds"]]
        for arm, settings in STUDY["arms"].items()
    }
    frozen.freeze(folder, frozen.to_freeze("quick", study_plan.read_study(STUDY)[0], configs))


def seal_study(folder: Path) -> None:
    path = folder / frozen.FROZEN
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Plain)
        if isinstance(content, dict):
            content["sha256"] = frozen.digest_of(content)
            path.write_text(yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False))
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, RecursionError):
        return  # no study any more


def read_study(folder: Path) -> object:
    return frozen.read_frozen(folder).hashes


def make_recording(folder: Path) -> None:
    recording: Mapping[str, Any] = {
        **{"schema": 1, "policy": "a", "rows": 2, "cols": 3, "n_agents": 2, "max_steps": 9},
        **{"house": "000223", "maps": ["000123"], "house_changes": [[3, 3], []]},
        **{"map_changes": [[[3, 3]], [[]]], "positions": [[0, 0, 1, 1]] * 3},
        **{"coverage": [0.25, 0.5, 1.0], "contacts": [[0, 1], []], "bits": [[1.0, 2.0]] * 2},
        **{"messages": base64.b64encode(bytes(12)).decode(), "message_numbers": 3, "largest": 1.0},
    }
    (folder / "replay.json").write_text(json.dumps(recording))


def of_run(folder: Path) -> object:
    return checked(load_config(folder / "plan-s0"))


FORMATS = {
    "manifest.json": Format(f"{FOLDER}/{BEST}/{MANIFEST}", make_checkpoint, read_weights),
    "state.json of weights": Format(
        f"{FOLDER}/{BEST}/{STATE}", make_checkpoint, read_weights, seal_checkpoints
    ),
    "state.json of a state": Format(
        f"{FOLDER}/{KEPT}/{STATE}", make_checkpoint, read_state, seal_checkpoints
    ),
    "tensors.safetensors": Format(
        f"{FOLDER}/{BEST}/{TENSORS}", make_checkpoint, read_weights, seal_checkpoints, True, True
    ),
    "config.yaml": Format("plan-s0/config.yaml", make_run, of_run),
    "evaluation.json": Format("plan-s0/evaluation.json", make_run, read_measured),
    "evaluation.json in a list": Format("plan-s0/evaluation.json", make_run, read_look),
    "metrics.csv": Format(
        "metrics.csv", make_metrics, lambda folder: read_metrics(folder / "metrics.csv")
    ),
    "run.json": Format("run.json", make_record, read_record),
    "first_updates.json": Format(
        "first_updates.json",
        make_first_updates,
        lambda folder: read_first_updates(folder / "first_updates.json"),
    ),
    **{
        f"plan{suffix}": Format(
            f"plan{suffix}",
            make_plan(suffix),
            read_plan(suffix),
            binary=suffix not in (".yaml", ".map", ".txt"),
        )
        for suffix in PLANS
    },
    "tidy.csv": Format("tidy.csv", make_exports, read_exported("tidy.csv")),
    "marl_eval.json": Format("marl_eval.json", make_exports, read_exported("marl_eval.json")),
    "study.yaml": Format(frozen.FROZEN, make_study, read_study, seal_study),
    "replay.json": Format(
        "replay.json", make_recording, lambda folder: read_recording(folder / "replay.json")
    ),
}
