"""metrics.csv and the progress that is shown."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from marl_clean.logger.base import Progress
from marl_clean.logger.csv import Csv
from marl_clean.logger.tensorboard import TensorBoard


def test_a_late_name_adds_a_column_and_the_clock_is_left_out(tmp_path):
    log = Csv(tmp_path)
    log.resume(0)
    log.log(10, {"loss": 0.1, "time/frames_per_second": 123.0})
    log.log(20, {"loss": 0.2, "validation/T_100": 91.5})
    log.log(30, {"validation/T_100": 90.0})
    log.close()
    rows = (tmp_path / "metrics.csv").read_text().splitlines()
    assert rows == ["frames,loss,validation/T_100", "10,0.1,", "20,0.2,91.5", "30,,90.0"]


def test_a_run_that_goes_back_drops_later_and_torn_rows(tmp_path):
    path = tmp_path / "metrics.csv"
    path.write_text("frames,loss,bits\n10,0.1,3\n20,0.2,4\n30,0.3,5\n40,0")
    log = Csv(tmp_path)
    log.resume(20)
    assert path.read_text() == "frames,loss,bits\n10,0.1,3\n20,0.2,4\n"
    log.log(30, {"loss": 0.5, "bits": 1})
    assert path.read_text().endswith("\n30,0.5,1\n")


def test_a_new_run_begins_an_empty_file(tmp_path):
    (tmp_path / "metrics.csv").write_text("frames,loss\n10,0.1\n")
    Csv(tmp_path).resume(0)
    assert (tmp_path / "metrics.csv").read_text() == "frames\n"


WHOLE = "frames,loss,bits\n10,0.1,3\n20,0.2,4\n30,0.3,5\n"
DAMAGES: dict[str, Callable[[Path], object]] = {
    "header": lambda path: path.write_text(WHOLE.replace("frames,loss", "fra")),
    "twice": lambda path: path.write_text(WHOLE.replace("bits", "loss")),
    "torn": lambda path: path.write_text(WHOLE.replace("20,0.2,4", "20,")),
    "zeros": lambda path: path.write_bytes(WHOLE.replace("0.2", "\0\0\0").encode()),
    "all zeros": lambda path: path.write_bytes(bytes(len(WHOLE))),
    "no text": lambda path: path.write_bytes(b"\xff\xfe" + WHOLE.encode()),
    "empty": lambda path: path.write_text(""),
    "deleted": lambda path: path.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_rows_are_a_part_of_the_state_or_their_loss_is_said(damage, tmp_path, caplog):
    path = tmp_path / "metrics.csv"
    path.write_text(WHOLE)
    first = Csv(tmp_path)
    first.resume(30)
    damage(path)
    second = Csv(tmp_path)
    second.restore(first.state())
    second.resume(20)
    assert path.read_text() == "frames,loss,bits\n10,0.1,3\n20,0.2,4\n"
    assert caplog.messages == []
    damage(path)
    Csv(tmp_path).resume(20)  # from a state of an earlier version, which has no rows
    [line] = caplog.messages
    assert "metrics.csv" in line and "\n" not in line
    assert path.read_text().startswith("frames")


def test_a_file_in_the_place_of_the_curves_is_passed_over(tmp_path, caplog):
    (tmp_path / "tensorboard").write_text("mine")
    curves = TensorBoard(tmp_path)
    curves.resume(0)
    curves.log(10, {"loss": 0.5})
    curves.close()
    [line] = caplog.messages
    assert line.endswith("tensorboard: is no folder; no curves are written there")
    assert (tmp_path / "tensorboard").read_text() == "mine"


def test_without_a_terminal_there_is_a_line_now_and_then(capsys):
    with Progress(1000, 200, every_seconds=0.0) as progress:
        progress.show(400, {"loss": 1.25, "reward": 3.0})
        progress.show(500, {})
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[1].startswith("500 of 1,000 frames")
    assert "loss 1.25" in lines[1]
    assert "reward" not in lines[1]
    assert lines[1].endswith("s left")


def test_lines_are_not_said_too_often(capsys):
    with Progress(1000, 0, every_seconds=60.0) as progress:
        for frames in range(1, 100):
            progress.show(frames, {})
    assert capsys.readouterr().err == ""


def test_in_a_terminal_there_is_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Progress(1000, 0, every_seconds=0.0) as progress:
        progress.show(250, {"epsilon": 0.5})
        assert progress.bar.tasks[0].percentage == pytest.approx(25)
        assert "epsilon 0.5" in progress.bar.tasks[0].fields["shown"]
    assert "of 1,000 frames" not in capsys.readouterr().err
