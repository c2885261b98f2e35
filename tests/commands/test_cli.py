"""The commands: exit codes, one line for bad input, and nothing left behind."""

import math
import os
import resource
import signal
import subprocess
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from marl_clean import __version__, cli
from marl_clean.commands import checks, listing
from marl_clean.commands.shorthand import with_floor_plans
from marl_clean.commands.sweep import named_jobs
from marl_clean.config.compose import compose_config
from marl_clean.config.levels import conf_folder, rooms
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.presets import sweep_of
from marl_clean.config.stored import load_config
from marl_clean.errors import BadInput
from tests.commands import bad_commands
from tests.commands.bad_commands import BAD_COMMANDS, MORE_BAD_COMMANDS, complaint, write_plans
from tests.families import family
from tests.reliability.short_jobs import finish, train_by

SWEEPING = [
    path.stem for path in sorted((conf_folder() / "experiment").glob("*.yaml")) if sweep_of(path)
]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with two plans that cannot be used."""
    monkeypatch.chdir(tmp_path)
    write_plans()
    return tmp_path


def files_in(place: Path) -> set[str]:
    return {path.name for path in place.iterdir()}


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "marl_clean", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("command", BAD_COMMANDS)
def test_bad_input_is_one_line_and_exit_2_within_3_seconds(place: Path, command: str) -> None:
    before, files = resource.getrusage(resource.RUSAGE_CHILDREN), files_in(place)
    result = run(*command.split())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert result.returncode == cli.BAD_INPUT
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1 and BAD_COMMANDS[command] in result.stderr
    assert files_in(place) == files
    # CPU time, which other processes on the machine do not stretch.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 3


@pytest.mark.parametrize("command", list(MORE_BAD_COMMANDS)[::8])  # all of them below
def test_bad_input_leaves_nothing(place: Path, command: str) -> None:
    assert complaint(command, MORE_BAD_COMMANDS[command]) == ""


def test_a_device_that_is_not_there(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["train", "device=cuda:99"]) == cli.BAD_INPUT
    assert "device=cuda:99: not on this machine; valid: cpu" in capsys.readouterr().err
    assert not Path("runs").exists()


@pytest.mark.parametrize("command", ["train", "train -m seed=1,2"])
def test_a_run_is_not_called_like_a_file(
    command: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("runs").mkdir()
    Path("runs/README.md").touch()
    assert cli.main([*command.split(), "name=README.md"]) == cli.BAD_INPUT
    assert "runs/README.md is a file; choose another name" in capsys.readouterr().err


COMPOSING = [
    "train",
    "train -m seed=1,2",
    "tune seed=1,2",
    "study quick_study",
    "evaluate",
    "watch",
    "figure paper_1",
    "figure single",
    "benchmark",
    "matrix RUN",
    "headroom",
]


@family("command", COMPOSING, fast=["train", "train -m seed=1,2"])
def test_every_command_refuses_what_one_check_refuses(
    command: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def planted(config: DictConfig) -> None:
        raise BadInput("planted: refused")

    (place / "RUN").mkdir()
    OmegaConf.save(compose_config(["name=mine"]), place / "RUN" / "config.yaml")
    monkeypatch.setattr(checks, "CHECKS", [planted])
    assert cli.main(command.split()) == cli.BAD_INPUT
    assert capsys.readouterr().err == "marl-clean: planted: refused\n"
    assert files_in(place) == {"RUN", "walls.txt", "broken.yaml"}


def test_commands_that_check_are_all_that_compose() -> None:
    without = {"list", "doctor", "compare", "report", "runs", "verify"}
    assert {command.split()[0] for command in COMPOSING} == cli.COMMANDS.keys() - without


@pytest.mark.parametrize("command", ["train", "train -m seed=1,2", "figure single"])
def test_the_optimum_without_or_tools_is_refused_before_training(
    command: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(checks, "is_installed", lambda name: False)
    assert cli.main([*command.split(), "evaluation.optimum=true"]) == cli.BAD_INPUT
    assert "needs OR-tools" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("command", ["benchmark", "watch planner=random env.compile=true"])
def test_compiling_from_a_path_with_a_space_is_bad_input(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = ModuleSpec("torch", None, origin="/my house/torch/__init__.py")
    monkeypatch.setattr(checks, "find_spec", lambda name: there)
    assert cli.main(command.split()) == cli.BAD_INPUT
    assert "env.compile=true: torch cannot compile" in capsys.readouterr().err


@pytest.mark.long
def test_all_bad_input_is_met_before_torch_is_imported(place: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", bad_commands.__name__],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        check=False,
    )
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_a_run_that_exists_is_not_overwritten_by_another_config(
    place: Path, capsys: pytest.CaptureFixture[str], trained: list[str]
) -> None:
    assert cli.main(["train", "name=mine"]) == 0
    assert cli.main(["train", "name=mine", "seed=1"]) == cli.BAD_INPUT
    assert "seed=0, not 1" in capsys.readouterr().err
    assert trained == ["mine"]


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the runs that a stand-in for training was asked for, in order."""

    names = []

    def main(config: DictConfig, folder: Path) -> None:
        if config.seed == 13:
            raise RuntimeError("thirteen")
        finish(config, folder)
        names.append(str(folder.relative_to("runs")))

    train_by(monkeypatch, main=main)
    return names


SWEEP = ["train", "-m", "hydra/launcher=basic"]  # in this process, where training is a stand-in


@pytest.mark.long
def test_a_sweep_gives_every_combination_its_folder(place: Path, trained: list[str]) -> None:
    settings = ["seed=1,2", "comm=plan,none", "evaluation.epsilon=choice(0.1)"]
    assert cli.main([*SWEEP, *settings]) == 0
    assert len(set(trained)) == 4
    assert files_in(place / "runs") == set(trained)
    assert all(name.startswith("run-") for name in trained)


@pytest.mark.slow
def test_a_named_sweep_is_one_folder_of_jobs(place: Path, trained: list[str]) -> None:
    assert cli.main([*SWEEP, "name=lamp", "seed=range(0,3)"]) == 0
    assert len(trained) == 3 and files_in(place / "runs") == {"lamp"}


@pytest.mark.long
def test_a_preset_has_a_sweep_and_settings_override_it_key_by_key(
    place: Path, trained: list[str]
) -> None:
    assert cli.main([*SWEEP, "+experiment=reward_sharing", "seed=7", "comm=none,plan"]) == 0
    assert len(set(trained)) == 2 * 3  # comm x reward, of one seed
    configs = [load_config(place / "runs" / name) for name in trained]
    assert {config["seed"] for config in configs} == {7}
    assert {config["env"]["memory"] for config in configs} == {"shared"}
    combinations = {(c["comm"]["_target_"], c["reward"]["_target_"]) for c in configs}
    assert len(combinations) == 6
    assert all("hydra" not in config for config in configs)


@pytest.mark.slow
def test_a_preset_that_sweeps_is_one_run_without_m(place: Path, trained: list[str]) -> None:
    assert cli.main(["train", "+experiment=reward_sharing"]) == 0
    [name] = trained
    assert name.startswith("reward_sharing-")


@pytest.mark.long
@pytest.mark.parametrize("preset", SWEEPING)
def test_every_sweep_of_a_preset_is_made_of_distinct_sound_jobs(preset: str) -> None:
    swept = sweep_of(conf_folder() / "experiment" / f"{preset}.yaml")
    seeds = "0,1" if preset == SWEEPING[-1] else "0"  # the others differ in no more
    fewer = {"seed": seeds} if "seed" in swept else {}
    jobs = named_jobs(parse_overrides([f"experiment={preset}", *map("=".join, fewer.items())]))
    assert len(jobs) == math.prod(len(v.split(",")) for v in {**swept, **fewer}.values())


@pytest.mark.slow
def test_every_job_is_checked_before_the_first_runs(place: Path, trained: list[str]) -> None:
    assert cli.main([*SWEEP, "env.n_agents=2,99"]) == cli.BAD_INPUT
    assert trained == []


@pytest.mark.slow
def test_a_failing_job_fails_the_sweep_after_the_others_ran(
    place: Path, trained: list[str]
) -> None:
    assert cli.main([*SWEEP, "seed=1,13,2"]) == 1
    assert len(trained) == 2


def test_signals_become_exit_codes(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(arguments: object) -> int:
        raise KeyboardInterrupt

    def terminated(arguments: object) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        return 0

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setitem(cli.COMMANDS, "list", interrupted)
    assert cli.main(["list"]) == 130
    monkeypatch.setitem(cli.COMMANDS, "list", terminated)
    with pytest.raises(SystemExit, match="143"):
        cli.main(["list"])
    assert signal.getsignal(signal.SIGTERM) is before


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"
    assert cli.main(["--help"]) == cli.main([]) == 0
    out = capsys.readouterr().out
    assert all(out.count(f"\n  {name} ") == 2 for name in cli.COMMANDS)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main([command, "--help"])
    assert f"marl-clean {command}" in capsys.readouterr().out


def test_list_shows_every_level_and_its_claim() -> None:
    lines = listing.lines()
    for room, levels in rooms().items():
        after = lines[lines.index(room) + 1 :]
        for line, level in zip(after, levels, strict=False):
            name, _, claim = line.strip().partition("  ")
            assert name == level and claim.strip()


@pytest.mark.slow
def test_doctor_finds_nothing_missing(capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["doctor"])
    out = capsys.readouterr().out
    assert code == 0, out
    assert "torchrl" in out and str(conf_folder()) in out


@pytest.mark.slow
def test_a_reader_that_leaves_early_is_no_error() -> None:
    line = f"'{sys.executable}' -m marl_clean list | head -n 1; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")


def test_a_floor_plan_stands_where_a_house_is_expected() -> None:
    spelled_out = ["house=floorplan", "house.path=apartment", "seed=1"]
    assert with_floor_plans(["house=apartment", "seed=1"]) == spelled_out
    assert with_floor_plans(["house='my home/flat.yaml'"])[1] == "house.path='my home/flat.yaml'"
    for level in (["house=open"], ["house=open,apartment"], ["house=nope"], ["name=apartment"]):
        assert with_floor_plans(level) == level
