"""Sweeps: what is finished is not run again, and what fails or is held stops no other job."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from marl_clean import cli
from marl_clean.commands import sweep
from marl_clean.commands._live import Pace, Watch, clock, labels_of
from marl_clean.commands.run_info import State, look
from marl_clean.config import hydra_launching
from marl_clean.config.hydra_adapter import Override
from marl_clean.config.hydra_launching import LAUNCHER
from marl_clean.errors import BadInput
from marl_clean.storage.lock import locked
from tests.reliability import short_jobs
from tests.reliability.short_jobs import BAD_SEED

IN_TURN = "hydra/launcher=basic"


@pytest.fixture
def trained(tmp_path, monkeypatch) -> list[int]:
    """The seeds that a stand-in for training was asked for, in order, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    seeds = []

    def main(config, folder, console=None):
        with locked(folder):
            seeds.append(config.seed)
            sys.stdout.write(f"this is seed {config.seed}\n")
            if config.seed == BAD_SEED:
                raise RuntimeError("thir\nteen")
            short_jobs.finish(config, folder)

    short_jobs.train_by(monkeypatch, main=main)
    return seeds


def run(*settings: str) -> tuple[int, str]:
    """The exit code of a sweep in this process, and its table."""
    out = io.StringIO()
    code = sweep.run([IN_TURN, *settings], Console(file=out, width=200))
    return code, out.getvalue()


@pytest.mark.long
def test_a_failed_job_is_named_and_tried_again_and_no_other_is(trained, capsys):
    code, table = run("seed=1,13,2")
    assert (code, trained) == (1, [1, 13, 2])
    assert "RuntimeError: thir teen" in table
    assert "3 jobs: 2 finished, 1 failed; the same command tries" in table
    [failed] = Path("runs").glob("*/failed.txt")
    text = failed.read_text()
    assert text.startswith("RuntimeError: thir teen\n\nsettings: seed=13 name=run-")
    assert "this is seed 13\n" in text and "Traceback" in text
    assert not (failed.parent / "config.yaml").exists()  # which would look like a run
    captured = capsys.readouterr()
    assert "this is seed" not in captured.out  # it is in the job's own log
    assert "(seed=13): failed, RuntimeError: thir teen" in captured.err

    again, table = run("seed=1,13,2")
    assert (again, trained) == (1, [1, 13, 2, 13])


@pytest.mark.long
def test_a_result_that_does_not_verify_is_made_again(trained):
    assert run("seed=1,2,3")[0] == 0
    torn, flipped, kept = sorted(Path("runs").iterdir())
    result = torn / "evaluation.json"
    result.write_bytes(result.read_bytes()[:-20])
    [weights] = flipped.glob("checkpoints/final-*/tensors.safetensors")
    weights.write_bytes(b"weighty")
    before = (kept / "evaluation.json").stat().st_mtime_ns
    seeds = [look(folder, folder.name).seed for folder in (torn, flipped)]
    trained.clear()
    run("seed=1,2,3")
    assert sorted(trained) == sorted(seeds)
    assert (kept / "evaluation.json").stat().st_mtime_ns == before


@pytest.mark.slow
def test_a_held_job_is_left_to_its_process_and_named(trained):
    jobs = sweep.named_jobs(sweep.parse_overrides(["seed=1,2"]))
    with locked(jobs[0].folder):
        code, table = run("seed=1,2")
    assert (code, trained) == (1, [2])
    assert f"held by process {os.getpid()} on" in table and "1 running, 1 finished" in table


@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced_but_not_for_ever(trained, monkeypatch):
    """A launcher whose pool breaks: the jobs that were running are resumed, the rest started."""
    launches = []

    def breaks(task, jobs, overrides):
        launches.append([job[0] for job in jobs])
        name = jobs[0][-1].removeprefix("name=")
        (Path("runs") / name).mkdir(parents=True, exist_ok=True)
        (Path("runs") / name / "job.log").touch()  # it has begun
        raise RuntimeError("a worker was killed")

    monkeypatch.setattr(sweep, "launch", breaks)
    code, table = run("seed=1,2")
    assert code == 1 and table.count("its process was killed 3 times") == 2
    assert launches == [["seed=1", "seed=2"]] * 3 + [["seed=2"]] * 3

    def starts_nothing(task, jobs, overrides):
        raise FileNotFoundError("no sbatch\nhere")

    monkeypatch.setattr(sweep, "launch", starts_nothing)
    with pytest.raises(BadInput, match="hydra/launcher: starts no job: no sbatch$"):
        run("seed=3")


@pytest.mark.slow
def test_joblib_is_the_default_for_several_jobs_on_several_cores(monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="extra `sweep`")
    import joblib

    configs = [job.config for job in sweep.named_jobs(sweep.parse_overrides(["seed=1,2,3"]))]
    monkeypatch.setattr(joblib, "cpu_count", lambda: 2)
    chosen = {o.key: o.value for o in sweep.default_launcher(configs)}
    assert chosen == {LAUNCHER: "joblib", "hydra.launcher.n_jobs": 2}
    assert sweep.default_launcher(configs[:1]) == []
    monkeypatch.setattr(joblib, "cpu_count", lambda: 1)
    assert sweep.default_launcher(configs) == []


@pytest.mark.parametrize(
    ("launcher", "extra"), [("joblib", "sweep"), ("submitit_slurm", "slurm"), ("rq", "rq")]
)
def test_a_missing_launcher_says_what_to_install(launcher, extra):
    override = Override(LAUNCHER, launcher, launcher, False, (), True)
    with pytest.raises(BadInput, match=f"is not installed; pip install .*{extra}"):
        hydra_launching._check_level(override, ["basic"])


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["seed=range(0,1)", "-m seed=range(0,1)"])
def test_functions_without_assertions_are_one_line(setting, tmp_path):
    command = [sys.executable, "-O", "-m", "marl_clean", "train", *setting.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (cli.BAD_INPUT, "")
    assert "PYTHONOPTIMIZE" in done.stderr and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_labels_are_what_sets_jobs_apart():
    jobs = {"a": ["x=1", "seed=0", "name=a"], "b": ["x=1", "seed=1", "name=b"]}
    assert labels_of(jobs) == {"a": "seed=0", "b": "seed=1"}
    assert clock(3725.0) == "1:02:05"


def test_speed_and_time_left_come_from_the_rows(tmp_path):
    pace = Pace()
    assert pace.note(100, 10.0) is None
    assert pace.note(300, 12.0) == 100
    assert pace.note(300, 15.0) == 100
    folder = tmp_path / "run-00000000"
    folder.mkdir()
    (folder / "config.yaml").write_text("seed: 4\ntrainer:\n  total_frames: 1000\n")
    (folder / "metrics.csv").write_text("frames,validation/T_90\n100,50\n300,40.25\n")
    console = Console(file=io.StringIO(), width=200)
    watch = Watch({folder.name: folder}, {folder.name: "seed=4"}, console)
    with locked(folder):
        watch._look()
        watch.paces[folder.name].speed = 100.0
        [info] = watch.infos.values()
        assert (info.state, info.seed, info.frames) == (State.RUNNING, 4, 300)
        expected = "run-00000000 (seed=4): running, 30 %, 100 frames/s, 0:00:07 left"
        assert watch.line(info) == f"{expected}, validation T_90 40.2"
        assert watch.summary() == "1 jobs: 1 running; 0:00:07 left"
        console.print(watch.table())
    assert "validation T_90 40.2" in console.file.getvalue()
