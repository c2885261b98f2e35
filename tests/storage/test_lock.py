"""The lock of a run's folder: one holder at a time, and none after a kill."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from marl_clean.config.stored import find_run
from marl_clean.errors import BadInput
from marl_clean.storage import lock
from marl_clean.storage.lock import LOCK, Held, check_free, holder, locked

ROOT = Path(__file__).parents[2]
HOLD = """
import sys, time
from pathlib import Path
from marl_clean.storage.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""
COUNT = """
import sys, time
from pathlib import Path
from marl_clean.storage.lock import Held, locked
folder, journal = Path(sys.argv[1]), Path(sys.argv[2])
taken = 0
while taken < 40:
    try:
        with locked(folder):
            taken += 1
            with journal.open("a") as file:
                file.write("in\\n")
                file.flush()
                time.sleep(0.0005)
                file.write("out\\n")
    except Held:
        pass
"""


def python(code: str, *arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_a_held_folder_says_by_whom_and_a_kill_frees_it(tmp_path):
    folder = tmp_path / "runs" / "mine"
    process = python(HOLD, folder)
    try:
        assert process.stdout.readline() == "held\n"
        assert holder(folder).pid == process.pid
        with pytest.raises(Held, match=rf"mine: held by process {process.pid} on .* since 2"):
            check_free(folder)
        with pytest.raises(Held, match=f"process {process.pid}"), locked(folder):
            pass
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert (folder / LOCK).exists() and holder(folder) is None
    with locked(folder):
        assert holder(folder).pid == os.getpid()
    assert not (folder / LOCK).exists()


def test_a_lock_leaves_no_folder_and_never_makes_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with locked(Path("runs/a/b")), pytest.raises(BadInput, match="has no config.yaml"):
        find_run("runs/a/b")
    assert list(tmp_path.iterdir()) == []
    with locked(Path("runs/a")):
        Path("runs/a/config.yaml").touch()
    assert [path.name for path in Path("runs/a").iterdir()] == ["config.yaml"]


def test_a_folder_that_cannot_be_written_is_bad_input(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match="cannot be written"), locked(tmp_path / "file" / "run"):
        pass


@pytest.mark.slow
def test_two_processes_are_never_inside_at_once(tmp_path):
    folder, journal = tmp_path / "runs" / "a", tmp_path / "journal"
    processes = [python(COUNT, folder, journal) for _ in range(2)]
    for process in processes:
        process.communicate(timeout=60)
    assert journal.read_text() == "in\nout\n" * 80


def test_a_filesystem_without_locks_is_worked_on_without(tmp_path, monkeypatch, caplog):
    def refused(*arguments: object) -> None:
        raise OSError(lock.WITHOUT_LOCKS[0], "no locks available")

    monkeypatch.setattr(lock.fcntl, "flock", refused)
    with locked(tmp_path):
        assert "no run is started twice" in caplog.text
