"""Sweeps on a Ray cluster of several nodes on this machine; it is skipped where Ray is missing."""

import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest

from tests.reliability.short_jobs import environment
from tests.reliability.sweeps import command, journal, training

JOBS = 6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_jobs_of_a_killed_node_are_begun_anew_on_another(tmp_path: Path, monkeypatch) -> None:
    cluster_utils = pytest.importorskip("ray.cluster_utils", reason="extra `ray`")
    settings = environment(tmp_path / "path", seconds=1.0)
    for name, value in settings.items():  # the nodes' workers inherit them
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("RAY_worker_niceness", "0")
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        cluster.add_node(num_cpus=1)
        doomed = cluster.add_node(num_cpus=1)
        address = f"hydra.launcher.address={cluster.address}"
        with (tmp_path / "printed.txt").open("wb") as file:
            sweep = subprocess.Popen(
                [*command("ray", JOBS), address], cwd=tmp_path, stdout=file, stderr=file
            )
        deadline = time.monotonic() + 120
        while len(training(tmp_path)) < 2:
            assert sweep.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        cluster.remove_node(doomed, allow_graceful=False)
        assert sweep.wait(300) == 0, (tmp_path / "printed.txt").read_text()
    finally:
        cluster.shutdown()
    events = Counter((event, name) for event, name, _ in journal(tmp_path))
    ends = [count for (event, _), count in events.items() if event == "end"]
    assert ends == [1] * JOBS
    assert sum(count for (event, _), count in events.items() if event == "begin") == JOBS + 1


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_jobs_too_which_note_it(tmp_path: Path, sent: int, code: int) -> None:
    pytest.importorskip("ray", reason="extra `ray`")
    settings = environment(tmp_path / "path", seconds=60.0) | {"RAY_worker_niceness": "0"}
    printed = tmp_path / "printed.txt"
    with printed.open("wb") as file:
        sweep = subprocess.Popen(
            command("ray", 3), cwd=tmp_path, env=settings, stdout=file, stderr=file
        )
    deadline = time.monotonic() + 120
    while not training(tmp_path):
        assert sweep.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    begun = list(training(tmp_path))
    sweep.send_signal(sent)
    assert sweep.wait(100) == code, printed.read_text()
    assert "*** SIG" not in printed.read_text()
    logs = [(tmp_path / "runs" / name / "job.log").read_text() for name in begun]
    assert all("stopped by a signal" in log for log in logs)
    assert not list(tmp_path.glob("runs/*/failed.txt"))


@pytest.mark.slow
def test_an_unreachable_cluster_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="extra `ray`")
    address = "hydra.launcher.address=127.0.0.1:1"
    done = subprocess.run(
        [*command("ray", 2), address], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    expected = f"marl-clean: {address}: no cluster answers: "
    assert done.stderr.splitlines()[-1].startswith(expected)
