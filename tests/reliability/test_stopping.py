"""A signal to the driver of a sweep under joblib: states saved, the exit code, no worker left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from marl_clean.storage.checkpoint import Checkpoints
from tests.reliability.test_sweeps import PLUGINS

LONG = [
    *("env.num_envs=8", "house.rows=[5,7]", "house.cols=[5,8]", "train_houses=20"),
    *("encoder.hidden=[16]", "evaluation.houses=2", "evaluation.plans=[]", "logger=csv"),
    *("trainer.frames_per_batch=64", "trainer.start_frames=64", "trainer.total_frames=10_000_000"),
    *("trainer.log_interval_frames=64", "trainer.eval_interval_frames=10_000_000"),
    *("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1,2"),
]


def children(of: int) -> list[int]:
    """Processes that descend from a process."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True)
    parents = {int(pid): int(parent) for pid, parent in map(str.split, listed.stdout.splitlines())}
    below = [of]
    for parent in below:
        below += [pid for pid, its in parents.items() if its == parent]
    return below[1:]


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.long
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_to_the_driver_ends_its_workers_with_their_states_saved(
    tmp_path: Path, sent: int, code: int
) -> None:
    pytest.importorskip(PLUGINS["joblib"], reason="extra `sweep` is not installed")
    printed = tmp_path / "printed.txt"
    with printed.open("wb") as file:
        sweep = subprocess.Popen(
            [sys.executable, "-m", "marl_clean", "train", "-m", *LONG],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
            stdout=file,
            stderr=file,
        )
    deadline = time.monotonic() + 300
    while len(trained := list(tmp_path.glob("runs/*/metrics.csv"))) < 2:
        assert sweep.poll() is None and time.monotonic() < deadline, printed.read_text()
        time.sleep(0.1)
    below = children(sweep.pid)
    sweep.send_signal(sent)
    assert sweep.wait(100) == code, printed.read_text()
    deadline = time.monotonic() + 5
    while left := [process for process in below if is_running(process)]:
        assert time.monotonic() < deadline, left
        time.sleep(0.1)
    for metrics in trained:
        assert Checkpoints(metrics.parent / "checkpoints").newest("state") is not None
        assert "stopped by a signal" in (metrics.parent / "job.log").read_text()
    assert not list(tmp_path.glob("runs/*/failed.txt"))
