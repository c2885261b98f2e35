"""Exports of a comparison: read back they give the same tables, and damaged ones are refused."""

import csv
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from marl_clean.commands import compare
from marl_clean.commands.efficiency_part import efficiency_of
from marl_clean.errors import BadInput
from marl_clean.evaluation.measured import Measured
from marl_clean.evaluation.records import SHOWN, make_entry
from marl_clean.evaluation.tidy import read_tidy, to_tidy
from tests.commands.test_compare import QUIET, write_run
from tests.families import family

pytestmark = pytest.mark.usefixtures("unchecked")
READABLE = ("marl_eval.json", "tidy.csv")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Runs of two settings and two worlds, with validation measures over training."""
    place = tmp_path_factory.mktemp("runs")
    written = [
        write_run(place / "plan-s0", ["seed=0"], [40, 60]),
        write_run(place / "plan-s1", ["seed=1"], [80, None]),
        write_run(place / "none-s0", ["comm=none", "seed=0"], [50, 50]),
        write_run(place / "none-s1", ["comm=none", "seed=1"], [55, 45]),
        write_run(place / "alone", ["env.memory=private"], [30, 20]),
    ]
    for run in written:
        lines = ["frames,validation/T_90,validation/T_100,loss", "100,90,95,1", "200,70.5,80,"]
        (Path(run) / "metrics.csv").write_text("\n".join(lines) + "\n")
    return written


@pytest.fixture(scope="module")
def exported(runs: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    compare.main(runs, None, QUIET, figure=False, export=folder)
    return folder


def everything(runs: list[str], folder: Path) -> list[str]:
    """All that a comparison prints and writes."""
    folder.mkdir()
    console = Console(record=True, width=180, file=io.StringIO())
    compare.main(runs, folder / "out.json", console, figure=False, export=folder / "again")
    names = ("out.json", "out_paired.json", "out_statistics.json", "again/tidy.csv")
    texts = [(folder / name).read_text() for name in (*names, "again/tables.tex")]
    return [console.export_text().replace(str(folder), ""), *texts]


@pytest.mark.slow
@pytest.mark.parametrize("name", READABLE)
def test_an_export_gives_the_tables_of_the_folders(
    name: str, runs: list[str], exported: Path, tmp_path: Path
) -> None:
    expected = everything(runs, tmp_path / "folders")
    assert everything([str(exported / name)], tmp_path / "export") == expected


@pytest.mark.slow
def test_an_export_and_folders_are_compared_together(runs: list[str], tmp_path: Path) -> None:
    compare.main(runs[:2], None, QUIET, figure=False, export=tmp_path / "half")
    rows = compare.main([str(tmp_path / "half/tidy.csv"), *runs[2:4]], None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == [
        "plan (2 seeds)",
        "none (2 seeds)",
        "nearest_unknown",
    ]
    # Seeds of one setting are pooled wherever they come from.
    compare.main(runs[:1], None, QUIET, figure=False, export=tmp_path / "one")
    rows = compare.main([str(tmp_path / "one/tidy.csv"), runs[1]], None, QUIET, figure=False)
    assert rows[0]["policy"] == "plan-s0 (2 seeds)"


def test_marl_eval_has_no_space_and_no_needless_digit(exported: Path) -> None:
    text = (exported / "marl_eval.json").read_text()
    assert "\n" not in text.rstrip()
    tree = json.loads(text)["marl_clean"]
    values = [
        value
        for task in tree.values()
        for algorithm in task.values()
        for run in algorithm.values()
        for value in run["absolute_metrics"]["T_90"]
    ]
    assert values and all(isinstance(value, int) for value in values)


def test_efficiency_has_the_measures_of_the_seeds_frame_by_frame(exported: Path) -> None:
    with (exported / "efficiency.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert {line["row"] for line in lines} >= {"comm=plan", "comm=none"}
    of_two = [line for line in lines if line["row"] == "comm=none" and line["measure"] == "T_90"]
    assert [(line["frames"], line["seeds"]) for line in of_two] == [("100", "2"), ("200", "2")]
    assert [float(line["iqm"]) for line in of_two] == [90.0, 70.5]
    assert all(float(line["low"]) <= float(line["iqm"]) <= float(line["high"]) for line in of_two)
    alone = [line for line in lines if line["row"] not in ("comm=plan", "comm=none")]
    assert alone and all(line["low"] == "NA" and line["seeds"] == "1" for line in alone)


def test_a_run_in_several_sets_of_houses_learns_once() -> None:
    entry = make_entry("run", "test", "hash", 0.0, 2, [dict.fromkeys(SHOWN, 1) | {"max_steps": 9}])
    twice = [Measured(world, "s", 0, entry, "row", folder=Path("run")) for world in "ab"]
    curves = efficiency_of(twice, {Path("run"): {"T_90": [(100.0, 5.0)]}})
    assert curves["row"]["T_90"].seeds.tolist() == [1]


@pytest.mark.slow
def test_a_damaged_log_of_training_is_left_out_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = write_run(tmp_path / "run", [], [40, 60])
    (Path(run) / "metrics.csv").write_text("nothing of ours")
    compare.main([run], None, QUIET, figure=False, export=tmp_path / "export")
    assert (tmp_path / "export/efficiency.csv").read_text().count("\n") == 1
    assert "left out" in caplog.text and "metrics.csv" in caplog.text


def test_tidy_has_a_line_for_each_house_and_a_column_for_each_measure(exported: Path) -> None:
    with (exported / "tidy.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    own = [line for line in lines if line["policy"] == "plan-s1"]
    assert [line["T_100"] for line in own] == ["80", "NA"]
    assert [line["house_seed"] for line in own] == ["7", "8"] and own[0]["seed"] == "1"
    assert {line["row"] for line in lines if line["policy"] == "none-s0"} == {"comm=none"}


def test_tidy_tells_null_from_what_was_not_measured(tmp_path: Path) -> None:
    """And keeps the properties of houses whose names are columns of the whole entry."""
    house = {"seed": 3, "row": 1, "house_seed": 2, "T_100": None, "T_90": 0.1 + 0.2, "path": "a,b"}
    other = {"seed": 4, "T_100": 5, "T_certify": None, "return": -1.5e-7}
    whole = {"max_steps": 9, **dict.fromkeys(SHOWN, 1), **{f"bound_{n}": 1 for n in (90, 100)}}
    measured = [
        Measured(
            f"world {index}", None, None, make_entry(f"p{index}", "test", "hash", 0.0, 2, houses)
        )
        for index, houses in enumerate(([{**whole, **house}] * 2, [{**whole, **other}]))
    ]
    path = tmp_path / "tidy.csv"
    path.write_text(to_tidy(measured))
    read = [item.entry["houses"] for item in read_tidy(path)]
    assert read == [item.entry["houses"] for item in measured]


def test_marl_eval_has_steps_and_absolute_metrics(exported: Path) -> None:
    tree = json.loads((exported / "marl_eval.json").read_text())
    assert list(tree) == ["marl_clean", "marl_clean_planners", "marl_clean_records"]
    [first, _] = tree["marl_clean"].values()
    assert first["comm=plan"]["seed_1"] == {
        "step_0": {"step_count": 100, "T_90": [90.0], "T_100": [95.0]},
        "step_1": {"step_count": 200, "T_90": [70.5], "T_100": [80.0]},
        "absolute_metrics": {"T_90": [80.0, 250.0], "T_100": [80.0, 250.0]},
    }
    for tasks in tree.values():  # numbers alone, as marl-eval asks for
        for algorithm in (runs for task in tasks.values() for runs in task.values()):
            for step in (step for run in algorithm.values() for step in run.values()):
                assert all(
                    isinstance(value, int | float)
                    for name, values in step.items()
                    for value in ([values] if name == "step_count" else values)
                )


def test_latex_is_escaped_and_has_intervals(exported: Path) -> None:
    text = (exported / "tables.tex").read_text()
    assert text.count(r"\begin{tabular}") == text.count(r"\bottomrule") == 2
    assert r"nearest\_unknown & -- & 50.0 {\small [50.0, 50.0]}" in text
    assert r"comm=plan & 2 & " in text


def repeated(text: str) -> str:
    """The same with one run, or its last line, a second time."""
    if text[0] != "{":
        return text + text.splitlines()[-1] + "\n"
    tree = json.loads(text)
    [first, _] = tree["marl_clean_records"].values()
    first["comm=plan"]["seed_9"] = first["comm=plan"]["seed_0"]
    return json.dumps(tree)


DAMAGED = {
    "empty": lambda text: "",
    "blank": lambda text: "\n \n",
    "half": lambda text: text[: len(text) // 2],
    "half, at the end of a line": lambda text: text[: text.rfind("\n", 0, len(text) // 2) + 1],
    "foreign": lambda text: '{"a": 1}' if text[0] == "{" else "a,b\n1,2\n",
    "a list": lambda text: "[1]",
    "deep": lambda text: "[" * 100_000,
    "words for numbers": lambda text: text.replace("250", '"much"'),
    "infinite": lambda text: text.replace("250", "1e999"),
    "true": lambda text: text.replace("250", "true"),
    "a measure renamed": lambda text: text.replace("T_100", "T_101", 30),
    "a run twice": lambda text: repeated(text),
}


@family(("name", "damage"), [(n, d) for n in READABLE for d in DAMAGED], fast=6)
def test_a_damaged_export_is_left_out_in_one_line(
    name: str, damage: str, exported: Path, runs: list[str], tmp_path: Path, caplog
) -> None:
    path = tmp_path / name
    path.write_text(DAMAGED[damage]((exported / name).read_text()))
    rows = compare.main([str(path), runs[4]], None, QUIET, figure=False)
    assert [row["policy"] for row in rows] == ["alone", "nearest_unknown"]
    [line] = caplog.messages
    assert str(path) in line and "\n" not in line and len(line) < 300


@pytest.mark.slow
@pytest.mark.parametrize("name", READABLE)
def test_entries_of_another_version_are_named_and_the_rest_is_compared(
    name: str, exported: Path, tmp_path: Path, caplog
) -> None:
    text = (exported / name).read_text()
    if name == "tidy.csv":
        head, *lines = text.splitlines()
        column = head.split(",").index("rules")
        cells = [line.split(",") for line in lines]
        for line in cells:
            line[column] = "7" if line[5] == "plan-s0" else line[column]
        text = "\n".join([head, *(",".join(line) for line in cells)]) + "\n"
    else:
        tree = json.loads(text)
        [first, _] = tree["marl_clean_records"].values()
        first["comm=plan"]["seed_0"]["absolute_metrics"]["about.rules"] = [7]
        text = json.dumps(tree)
    (tmp_path / name).write_text(text)
    rows = compare.main([str(tmp_path / name)], None, QUIET, figure=False)
    assert rows[0]["policy"] == "comm=plan"  # of seed 1 alone
    assert [m for m in caplog.messages if "world version 7, only 1 and 0 are valid" in m]
    assert len([m for m in caplog.messages if m.startswith("left out")]) == 1


def test_a_binary_and_another_file_are_refused(runs: list[str], tmp_path: Path, caplog) -> None:
    (tmp_path / "tidy.csv").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "notes.txt").write_text("nothing")
    names = [str(tmp_path / name) for name in ("tidy.csv", "notes.txt")]
    with pytest.raises(BadInput, match="no finished run"):
        compare.main(names, None, QUIET)
    assert ["is not text" in caplog.messages[0], "no export" in caplog.messages[1]] == [True, True]


def test_an_export_that_cannot_be_written_is_bad_input(runs: list[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="--export"):
        compare.main(runs[4:], None, QUIET, figure=False, export=tmp_path / "file")
