"""Gaps to an oracle: a run under other rules in the same houses, in `compare` and on the page."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from marl_clean import cli
from marl_clean.commands import compare, report
from marl_clean.errors import BadInput
from tests.commands.test_compare import QUIET, write_run

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def runs(tmp_path: Path) -> tuple[list[str], str]:
    silent = write_run(tmp_path / "silent", ["comm=none"], [40, 80])
    return [silent], write_run(tmp_path / "told", ["env.memory=merged"], [20, 60])


@pytest.mark.slow
def test_the_gap_is_one_minus_the_mean_ratio_to_the_oracles_time(runs) -> None:
    own, told = runs
    [world] = compare.compared(own, oracle=told)
    [row] = [row for row in world.statistics if row["row"] == "silent"]
    gap = row["aggregates"]["score_to_oracle"]["optimality_gap"]
    assert gap["value"] == pytest.approx(1 - (20 / 40 + 60 / 80) / 2)
    console = Console(record=True, width=180, file=io.StringIO())
    compare.main(own, None, console, figure=False, oracle=told)
    assert "gap to oracle" in console.export_text()


@pytest.mark.slow
def test_the_page_shows_it_where_an_oracle_is_given(runs, tmp_path: Path) -> None:
    own, told = runs
    with_gap = report.main(own, tmp_path / "a.html", QUIET, oracle=told).read_text()
    without = report.main(own, tmp_path / "b.html", QUIET).read_text()
    assert "gap to oracle" in with_gap and "0.38" in with_gap
    assert "gap to oracle" not in without


def test_what_is_no_oracle_is_one_line(runs, capsys: pytest.CaptureFixture[str]) -> None:
    own, _ = runs
    with pytest.raises(BadInput, match="--oracle nothing: no such row, and no folder of a run"):
        report.main(own, None, QUIET, oracle="nothing")
    assert cli.main(["report", *own, "--oracle", "nothing"]) == cli.BAD_INPUT
    assert capsys.readouterr().err.startswith("marl-clean: --oracle nothing: no such row")
