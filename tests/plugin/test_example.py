"""The package in examples/plugin, installed: found, listed, trained with, and its own tests."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGIN = ROOT / "examples" / "plugin"
TINY = [
    "comm=loudest",
    "house=corridor",
    "planner=right_hand",
    "house.rooms=[1,1]",
    "house.width=2",
    "house.depth=1",
    "budget=smoke",
    "train_houses=4",
    "observation.view_size=5",
    "env.num_envs=16",
    "env.max_steps=20",
    "trainer.total_frames=512",
    "trainer.frames_per_batch=256",
    "trainer.start_frames=0",
    "trainer.batch_frames=32",
    "trainer.replay_ratio=0.25",
    "evaluation.houses=3",
    "evaluation.plans=[]",
    "name=tidy",
]


def python(*arguments: str, at: Path, paths: list[Path]) -> subprocess.CompletedProcess:
    """Run Python in a folder, with packages from these places beside the environment's."""
    path = os.pathsep.join(map(str, [*paths, ROOT]))
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "ignore", *arguments]
    return subprocess.run(
        command, cwd=at, env=environment, capture_output=True, text=True, timeout=400
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the package is installed into; from a copy, since a build leaves files."""
    place = tmp_path_factory.mktemp("installed")
    shutil.copytree(PLUGIN, place / "source", ignore=shutil.ignore_patterns("__pycache__"))
    offline = ["--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    into = ["--target", str(place / "site"), str(place / "source")]
    done = python("-m", "pip", "install", "-q", *offline, *into, at=place, paths=[])
    assert done.returncode == 0, done.stderr
    return place / "site"


@pytest.fixture(scope="module")
def trained(site: Path) -> Path:
    """A folder in which a run with the package's levels was trained and measured, by a process.

    And its planner was measured in its house.
    """
    of_planner = ["planner=right_hand", "house=corridor", "out=right_hand.json"]
    commands = [
        ["train", *TINY],
        ["evaluate", "checkpoint=tidy", "evaluation.houses=2", "out=tidy.json"],
        ["evaluate", *of_planner, "evaluation.houses=2"],
    ]
    program = f"from marl_clean.cli import main; assert [*map(main, {commands})] == [0, 0, 0]"
    done = python("-c", program, at=site.parent, paths=[site])
    assert done.returncode == 0, done.stderr
    return site.parent


@pytest.mark.long
def test_installed_its_levels_are_there(site: Path, tmp_path: Path) -> None:
    listed = python("-m", "marl_clean", "list", at=tmp_path, paths=[site])
    assert listed.returncode == 0, listed.stderr
    for level in ("loudest", "corridor", "right_hand"):
        [line] = [line for line in listed.stdout.splitlines() if line.split()[:1] == [level]]
        assert line.endswith("(tidy_lab)") and len(line) < 120
    wrong = python("-m", "marl_clean", "train", "planner=right_hnd", at=tmp_path, paths=[site])
    assert wrong.returncode == 2 and "did you mean right_hand?" in wrong.stderr
    assert wrong.stderr.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.long
def test_a_run_is_trained_and_measured_with_them(trained: Path) -> None:
    for policy in ("tidy", "right_hand"):
        assert f'"policy": "{policy}"' in (trained / f"{policy}.json").read_text()


@pytest.mark.slow
def test_without_the_package_the_run_names_it(trained: Path) -> None:
    missing = python("-m", "marl_clean", "evaluate", "checkpoint=tidy", at=trained, paths=[])
    assert missing.returncode == 2 and missing.stderr.count("\n") == 1
    assert "--plugin tidy_lab" in missing.stderr


@pytest.mark.slow
def test_where_it_is_not_installed_it_is_named(tmp_path: Path) -> None:
    """From its source, which declares no entry point."""
    listed = ["-m", "marl_clean", "list"]
    without = python(*listed, at=tmp_path, paths=[PLUGIN])
    assert without.returncode == 0 and "tidy_lab" not in without.stdout
    named = python(*listed, "--plugin", "tidy_lab", at=tmp_path, paths=[PLUGIN])
    assert named.returncode == 0 and named.stdout.count("(tidy_lab)") == 3


@pytest.mark.long
def test_its_own_tests_pass(site: Path) -> None:
    pytest_ = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = python(*pytest_, at=site.parent / "source", paths=[site])
    assert done.returncode == 0, done.stdout
    assert "5 passed" in done.stdout
