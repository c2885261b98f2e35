"""run.json: what was done, by which code, on which machine, in how long and with what energy."""

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from marl_clean import cli
from marl_clean.commands import energy, made_with, run_record
from marl_clean.commands import train as train_command
from marl_clean.commands.command_line import issued
from marl_clean.commands.energy import CpuEnergy
from marl_clean.commands.run_record import RECORD, earlier_processes, recorded
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash

RANGE = 1_000_000  # microjoules


def zone(powercap: Path, name: str, about: str, value: int) -> Path:
    folder = powercap / name
    folder.mkdir(parents=True)
    (folder / "name").write_text(f"{about}\n")
    (folder / "max_energy_range_uj").write_text(f"{RANGE - 1}\n")
    (folder / "energy_uj").write_text(f"{value}\n")
    return folder / "energy_uj"


def test_packages_are_added_and_a_counter_that_began_anew_goes_on(tmp_path: Path) -> None:
    first = zone(tmp_path, "intel-rapl:0", "package-0", 900_000)
    second = zone(tmp_path, "intel-rapl:1", "package-1", 100)
    core = zone(tmp_path, "intel-rapl:0:0", "core", 0)
    platform = zone(tmp_path, "intel-rapl:2", "psys", 0)
    meter = CpuEnergy(tmp_path)
    first.write_text("100000")  # 200,000 further, past its range
    second.write_text("300100")
    core.write_text("77777")  # within the first package
    platform.write_text("77777")  # around both
    meter.read()
    first.write_text("50000")  # 950,000 further
    assert meter.close() == pytest.approx((200_000 + 300_000 + 950_000) / 1e6)


def test_rounds_are_counted_while_a_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(energy, "READ_EVERY_SECONDS", 0.001)
    counter = zone(tmp_path, "intel-rapl:0", "package-0", 0)
    meter = CpuEnergy(tmp_path)
    for value in (600_000, 200_000, 800_000):  # two rounds, of which the ends show one
        counter.with_name("next").write_text(str(value))
        counter.with_name("next").replace(counter)
        until = time.monotonic() + 5
        while meter.packages[0].last != value and time.monotonic() < until:
            time.sleep(0.001)
    assert meter.close() == pytest.approx(1.8)


def test_a_system_that_tells_no_energy_has_none(tmp_path: Path) -> None:
    assert CpuEnergy(tmp_path / "nothing").close() is None
    (zone(tmp_path / "torn", "intel-rapl:0", "package-0", 5)).write_text("unknown")
    assert CpuEnergy(tmp_path / "torn").close() is None
    counter = zone(tmp_path / "half", "intel-rapl:0", "package-0", 5)
    zone(tmp_path / "half", "intel-rapl:1", "package-1", 5).unlink()  # one of two
    assert CpuEnergy(tmp_path / "half").close() is None
    (tmp_path / "half" / "intel-rapl:1" / "energy_uj").write_text("5")
    meter = CpuEnergy(tmp_path / "half")
    counter.unlink()  # no longer
    assert meter.close() is None


def git(folder: Path, *arguments: str) -> None:
    about = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    subprocess.run(["git", "-C", str(folder), *about, *arguments], check=True, capture_output=True)


@pytest.mark.slow
def test_a_tree_is_clean_until_a_file_changes_or_is_added(tmp_path: Path) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").touch()
    assert made_with.git_state(package) == {"commit": None, "clean": None}
    git(tmp_path, "init", "-q")
    assert made_with.git_state(package) == {"commit": None, "clean": None}  # not this tree's
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "a")
    state = made_with.git_state(package)
    assert len(state["commit"]) == 40 and state["clean"] is True
    (package / "level.py").touch()
    assert made_with.git_state(package) == {**state, "clean": False}
    (package / "level.py").unlink()
    (package / "__init__.py").write_text("changed")
    assert made_with.git_state(package) == {**state, "clean": False}


@pytest.mark.slow
def test_an_install_from_git_has_the_commit_that_pip_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "of_git-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: of_git\nVersion: 1.0\n")
    (info / "direct_url.json").write_text(json.dumps({"vcs_info": {"commit_id": "ab" * 20}}))
    (tmp_path / "of_git").mkdir()
    (tmp_path / "of_git" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert made_with.git_state(tmp_path / "of_git") == {"commit": "ab" * 20, "clean": True}
    assert made_with.version_of("of_git") == "1.0"


def test_the_processor_is_the_one_that_linux_names(tmp_path: Path) -> None:
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\n")
    assert made_with.cpu_model(tmp_path / "cpuinfo") == "Some CPU @ 2 GHz"


def record_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / RECORD).read_text())


@pytest.mark.slow
def test_every_process_is_added_and_says_how_it_ended(tmp_path: Path) -> None:
    cfg = compose_config(["name=mine", "seed=3"])
    with issued(["train", "name=mine"]), pytest.raises(SystemExit):
        with recorded(cfg, tmp_path) as begin:
            begin()
            [killed] = record_in(tmp_path)["processes"]  # as a kill would leave it
            assert killed["ended"] is killed["wall_seconds"] is None
            raise SystemExit(143)
    with pytest.raises(ValueError), recorded(cfg, tmp_path) as begin:
        begin()
        raise ValueError
    with recorded(cfg, tmp_path) as begin:
        begin()
        begin()
    record = record_in(tmp_path)
    assert (record["name"], record["seed"]) == ("mine", 3)
    assert record["config_sha256"] == config_hash(cfg)
    processes = record["processes"]
    assert [p["ended"] for p in processes] == ["stopped", "ValueError", "finished"]
    assert processes[0]["command"] == "marl-clean train name=mine"
    for process in processes:
        assert process["wall_seconds"] >= 0 and "cpu_joules" in process
        assert process["versions"]["torch"] and process["hardware"]["cores"] >= 1
        assert set(process["code"]["marl_clean"]) == {"version", "commit", "clean"}


def test_where_nothing_is_done_nothing_is_recorded(tmp_path: Path) -> None:
    with recorded(compose_config([]), tmp_path):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 0, "processes": []}', "[" * 9999])
def test_a_record_that_is_not_whole_is_begun_anew_in_one_line(
    text: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / RECORD).write_text(text)
    assert earlier_processes(tmp_path / RECORD) == []
    assert caplog.text.count("\n") == 1


def test_a_full_disk_stops_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(run_record.files, "write_file", full)
    with recorded(compose_config([]), tmp_path) as begin:
        begin()
    assert "No space left on device" in caplog.text


@pytest.mark.long
@pytest.mark.usefixtures("unchecked")
def test_training_records_itself_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = (
        "train +experiment=quick name=run trainer.total_frames=256 evaluation.houses=2"
        " trainer.eval_interval_frames=256 trainer.log_interval_frames=128"
        " trainer.start_frames=64 evaluation.plans=[] train_houses=8 env.max_steps=20"
    )
    monkeypatch.setattr(train_command, "draw", lambda cfg, folder: None)
    for _ in range(2):  # the second time it is finished
        assert cli.main(command.split()) == 0
        [process] = record_in(Path("runs/run"))["processes"]
    assert process["ended"] == "finished"
    (Path("runs/run/evaluation.json")).unlink()
    assert cli.main(command.split()) == 0  # measured again
    assert [p["ended"] for p in record_in(Path("runs/run"))["processes"]] == ["finished"] * 2
