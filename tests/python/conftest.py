"""One small trained run, for all that is done with runs."""

from pathlib import Path
from typing import Any

import pytest

import marl_clean

SMALL: dict[str, Any] = {
    "num_envs": 8,
    "rows": [5, 7],
    "cols": [5, 7],
    "view_size": 7,
    "train_houses": 8,
    "max_steps": 20,
    "houses": 3,
    "plans": [],
    "precision": "float32",
    "frames_per_batch": 64,
    "batch_frames": 16,
    "replay_ratio": 0.25,
    "start_frames": 64,
    "buffer_frames": 300,
    "total_frames": 256,
    "log_interval_frames": 64,
    "eval_interval_frames": 128,
    "checkpoint_interval_frames": 256,
}


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A working directory of the module's own."""
    folder = tmp_path_factory.mktemp("workplace")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture(scope="module")
def run(workplace: Path) -> marl_clean.Run:
    """A run of robots that remember, talk late and lose messages."""
    settings = ["encoder.memory=gru", "comm=commnet"]
    channel = {"channel": ["lossy", "delayed"], "burst_start": 0.3, "steps": 2}
    return marl_clean.train(settings, name="mine", **channel, **SMALL)
