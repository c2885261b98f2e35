"""`run.json`: how a run was made. Config and seed, and of every process that worked on it its
command, code, versions, machine, wall time and energy.

A process is added when it begins and completed when it ends: one that was killed has no end.
"""

import json
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from marl_clean.commands import made_with
from marl_clean.commands.command_line import command_line
from marl_clean.commands.energy import CpuEnergy
from marl_clean.config.config_hash import config_hash
from marl_clean.storage import files
from marl_clean.storage.reading import parse_json, read_bytes

RECORD = "run.json"
SCHEMA = 1
LARGEST_BYTES = 16 << 20  # as of some thousand processes
FINISHED, STOPPED = "finished", "stopped"  # by a signal; else it ended with an error of this name
log = logging.getLogger(__name__)


@contextmanager
def recorded(cfg: DictConfig, folder: Path) -> Iterator[Callable[[], None]]:
    """Record what is done within the context, from the call of what it yields on.

    That is called when the run's folder exists and there is something to do; a second call does
    nothing. Wall time and energy count from the context's beginning.
    """
    began, energy = time.monotonic(), CpuEnergy()
    process: dict[str, Any] = {
        "command": command_line(),
        "began": datetime.now(UTC).isoformat(timespec="seconds"),
        "ended": None,
        "wall_seconds": None,
        "cpu_joules": None,
    }
    record: dict[str, Any] = {}

    def begin() -> None:
        if record:
            return
        process["code"] = made_with.code()
        process["versions"] = made_with.versions()
        process["hardware"] = made_with.hardware(cfg.device)
        record.update(
            schema=SCHEMA,
            name=cfg.name,
            config_sha256=config_hash(cfg),
            seed=cfg.seed,
            processes=[*earlier_processes(folder / RECORD), process],
        )
        _write(folder / RECORD, record)

    try:
        yield begin
        process["ended"] = FINISHED
    except (SystemExit, KeyboardInterrupt):
        process["ended"] = STOPPED
        raise
    except BaseException as error:
        process["ended"] = type(error).__name__
        raise
    finally:
        process["wall_seconds"] = round(time.monotonic() - began, 1)
        process["cpu_joules"] = energy.close()
        if record:
            _write(folder / RECORD, record)


def earlier_processes(path: Path) -> list[dict[str, Any]]:
    """The processes in a run.json; none, with a line in the log, where it is not whole."""
    if not path.exists():
        return []
    record = _read(path)
    processes = record.get("processes")
    if record.get("schema") == SCHEMA and isinstance(processes, list):
        if all(isinstance(process, dict) for process in processes):
            return processes
    log.warning("%s: is not of schema %s; begun anew", path, SCHEMA)
    return []


def recorded_hash(folder: Path) -> str | None:
    """The hash of the config of the run in `folder`; None where no record tells it."""
    recorded = _read(folder / RECORD).get("config_sha256")
    return recorded if isinstance(recorded, str) else None


def _read(path: Path) -> dict[str, Any]:
    """A run.json, which need not be trusted; empty where there is none that can be read."""
    with suppress(ValueError):  # BadInput is one, too
        record = parse_json(read_bytes(path, LARGEST_BYTES))
        if isinstance(record, dict):
            return record
    return {}


def _write(path: Path, record: dict[str, Any]) -> None:
    """Write the record; a full disk stops no run."""
    try:
        files.write_file(path, [json.dumps(record, indent=1).encode() + b"\n"])
    except OSError as error:
        log.warning("%s: cannot be written: %s", path, error.strerror)
