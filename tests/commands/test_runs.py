"""`marl-clean runs`: states, filters, and what --clean removes."""

import io
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from marl_clean import cli
from marl_clean.commands import runs
from marl_clean.commands.runs import age, size
from marl_clean.config.compose import compose_config
from marl_clean.storage import files, manifest
from marl_clean.storage.lock import locked
from tests.reliability.short_jobs import finish


@pytest.fixture(autouse=True)
def _four_runs(tmp_path, monkeypatch) -> None:
    """A run in each state, one more in a named sweep, and folders that are no runs."""
    monkeypatch.chdir(tmp_path)
    for name, seed in (("quick-00000001", 1), ("lamp/00000002", 2)):
        finish(compose_config(["budget=smoke", f"seed={seed}", f"name={name}"]), Path("runs", name))
    failed, unfinished = Path("runs/quick-00000003"), Path("runs/mine")
    for folder in (failed, unfinished, Path("runs/figures"), Path("runs/.submitit")):
        folder.mkdir()
    (failed / "failed.txt").write_text("RuntimeError: no luck\n\nmore")
    (unfinished / "config.yaml").write_text("seed: 7\ntrainer:\n  total_frames: 900\n")
    (unfinished / "metrics.csv").write_text("frames,loss\n300,1\n600,")


def listed(*arguments, **filters) -> tuple[dict[str, str], str]:
    console = Console(file=io.StringIO(), width=200)
    infos = runs.main(*arguments, **filters, console=console)
    return {info.name: info.state.value for info in infos}, console.file.getvalue()


@pytest.mark.slow
def test_every_state_is_listed_with_what_is_known():
    with locked(Path("runs/quick-00000001")):
        states, table = listed()
    assert states == {
        "lamp/00000002": "finished",
        "mine": "unfinished",
        "quick-00000001": "running",
        "quick-00000003": "failed",
    }
    assert "failed: RuntimeError: no luck" in table and "4 runs in runs/" in table
    [mine] = (line for line in table.splitlines() if line.strip().startswith("mine"))
    assert mine.split()[1:7] == ["unfinished", "-", "7", "300", "of", "900"]


@pytest.mark.slow
def test_filters_narrow_the_list():
    assert list(listed(["quick-*"])[0]) == ["quick-00000001", "quick-00000003"]
    assert list(listed([], ["finished"])[0]) == ["lamp/00000002", "quick-00000001"]
    assert list(listed([], ["finished"], ["quick"])[0]) == ["quick-00000001"]


def add_state(folder: str) -> Path:
    path = Path(folder, manifest.FOLDER, f"state-{600:012d}")
    contents = {manifest.TENSORS: [b"x" * 2000], manifest.STATE: [b"{}"]}
    path.parent.mkdir(exist_ok=True)
    files.write_folder(path, contents, manifest.MANIFEST, manifest.make_manifest)
    return path


@pytest.mark.slow
def test_clean_removes_states_of_finished_runs_after_asking(monkeypatch, capsys):
    finished, unfinished = add_state("runs/quick-00000001"), add_state("runs/mine")
    assert cli.main(["runs", "--clean"]) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert "no terminal to ask at; add --yes" in error and error.count("\n") == 1
    terminal = type("Terminal", (io.StringIO,), {"isatty": lambda self: True})
    monkeypatch.setattr(sys, "stdin", terminal("n\n"))
    assert cli.main(["runs", "--clean"]) == 0
    assert "nothing removed" in capsys.readouterr().out and finished.exists()
    with locked(finished.parents[1]):  # it is running, and so none of the finished ones
        assert cli.main(["runs", "--clean", "--yes"]) == 0
    assert finished.exists()
    assert cli.main(["runs", "--clean", "--yes"]) == 0
    assert "removed: 1 states of 1 finished runs, 2.2 kB" in capsys.readouterr().out
    assert not finished.exists() and unfinished.exists()
    assert cli.main(["runs", "--clean"]) == 0


@pytest.mark.slow
def test_a_damaged_run_keeps_its_states(capsys):
    state = add_state("runs/quick-00000001")
    [weights] = Path("runs/quick-00000001").glob("checkpoints/final-*/tensors.safetensors")
    weights.write_bytes(b"weighty")
    assert cli.main(["runs", "--clean", "--yes"]) == 0
    assert "left as it is: runs/quick-00000001" in capsys.readouterr().out
    assert state.exists()


@pytest.mark.long
def test_a_thousand_runs_are_listed_in_seconds():
    finished = Path("runs/quick-00000001")
    for number in range(1000):
        folder = Path(f"runs/quick-{number + 16:08x}")
        (folder / "checkpoints").mkdir(parents=True)
        (folder / "checkpoints" / f"final-{6144:012d}").mkdir()
        for name in ("config.yaml", "evaluation.json", "metrics.csv"):
            if (finished / name).exists():
                (folder / name).write_bytes((finished / name).read_bytes())
    began = time.process_time()
    assert len(listed()[0]) == 1004
    assert time.process_time() - began < 5


def test_sizes_and_ages_are_short():
    assert [size(n) for n in (0, 999, 1500, 12_345_678, 2 * 10**12)] == [
        "0 B", "999 B", "1.5 kB", "12 MB", "2000 GB",
    ]  # fmt: skip
    assert [age(s) for s in (-1.0, 59.0, 3599.0, 90_000.0)] == ["0 s", "59 s", "59 min", "1 d"]
