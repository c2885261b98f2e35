"""Each mismatch that is planted is one line of `marl-clean doctor`, with how to mend it."""

import os
import time
import webbrowser
from collections import namedtuple
from importlib import metadata
from pathlib import Path

import pytest

from marl_clean import cli
from marl_clean.commands import _machine, doctor
from marl_clean.commands._machine import Finding, clock, gpu
from marl_clean.storage import files

Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def line_of(name: str, report: list[Finding]) -> str:
    """The line about what is wrong, which has a remedy."""
    [finding] = [each for each in report if each.name == name]
    [line] = doctor.lines_of([finding])
    assert finding.remedy and line.endswith(finding.remedy) and "\n" not in line
    return line


def machine() -> list[Finding]:
    return list(_machine.machine_findings())


def test_nothing_is_wrong_here_and_nothing_is_left(place: Path) -> None:
    assert [finding.remedy for finding in machine()] == [""] * 6
    assert not list(place.iterdir())


def test_a_full_disk(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        _machine.shutil, "disk_usage", lambda path: Usage(9 << 30, 8 << 30, 1 << 30)
    )
    assert "1.0 GiB free  -> free 2 GiB, or" in line_of("disk", machine())


def test_a_slow_file_system(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_machine, "SLOW_SECONDS", 0.0)
    assert "ms a flushed file  -> start on a local disk" in line_of("writing", machine())


def test_a_folder_that_cannot_be_written(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*arguments: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(files, "write_file", refused)
    assert "refused: Read-only file system  -> start in a folder" in line_of("writing", machine())


@pytest.mark.parametrize("off", [-7200.0, 30.0])
def test_a_clock_that_is_not_that_of_the_files(place: Path, off: float) -> None:
    line = line_of("clock", [clock(off)])
    assert f"{abs(off):.0f} s off the times of new files  -> set the clocks" in line


def test_a_clock_that_went_back(place: Path) -> None:
    run = place / "runs" / "mine"
    run.mkdir(parents=True)
    os.utime(run, (time.time() + 5000,) * 2)
    assert "went back: " in (line := line_of("clock", machine())) and str(run) in line


def test_a_locale_without_utf8(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "ANSI_X3.4-1968"
    monkeypatch.setattr(_machine.locale, "getpreferredencoding", lambda setlocale: name)
    assert f"{name}  -> export PYTHONUTF8=1" in line_of("locale", machine())


def test_a_machine_without_a_browser_is_said_to_need_none(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise webbrowser.Error

    monkeypatch.setattr(_machine.webbrowser, "get", missing)
    assert _machine.browser() == Finding(
        "browser", "none: copy report.html, one file, to where there is one"
    )


def test_a_launcher_whose_package_is_broken(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_machine, "launchers", lambda: ["basic"])
    monkeypatch.setattr(_machine, "is_installed", lambda name, module: "joblib" in name)
    expected = "is installed, joblib is missing  -> pip install --force-reinstall hydra-joblib-"
    assert expected in line_of("launchers", machine())


def test_launchers_that_are_not_installed_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_machine, "launchers", lambda: ["basic"])
    monkeypatch.setattr(_machine, "is_installed", lambda name, module: False)
    state = _machine.launching().state
    assert "basic (not installed: joblib: pip install 'marl-clean[sweep]'; ray: pip" in state


def test_a_gpu_that_torch_does_not_see(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_machine, "DRIVERS", (str(tmp_path),))
    finding = gpu(devices=0)
    assert finding is not None
    assert "torch does not see it  -> install torch for CUDA" in line_of("gpu", [finding])
    assert gpu(devices=1) is None
    monkeypatch.setattr(_machine, "DRIVERS", (str(tmp_path / "none"),))
    assert gpu(devices=0) is None


def test_versions_out_of_range_missing_and_not_the_measured_ones(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = metadata.version

    def planted(name: str) -> str:
        if name == "rich":
            raise metadata.PackageNotFoundError(name)
        return {"torchrl": "0.9.0", "torch": "2.14.1+cpu"}.get(name) or whole(name)

    monkeypatch.setattr(doctor.metadata, "version", planted)
    assert cli.main(["doctor"]) == 1
    lines = capsys.readouterr().out.splitlines()
    said = {name: line for line in lines for name in ("rich", "torchrl", "torch<") if name in line}
    assert said["rich"].endswith("missing  -> pip install 'rich>=13'")
    assert "0.9.0  -> pip install 'torchrl<0.15,>=0.14.1'" in said["torchrl"]
    assert "2.14.1+cpu (measured with 2.13.0; pip install 'torch==2.13.0')" in said["torch<"]
