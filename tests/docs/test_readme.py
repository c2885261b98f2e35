"""The front page: its length and order, its links, settings, figures and Python."""

import re
import runpy
from pathlib import Path

import pytest

from marl_clean.config.compose import compose_config
from marl_clean.config.levels import groups, rooms

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ORDER = ["Install", "One minute", "Results", "Rooms", "A scheme of your own", "Read on", "Cite"]
TEXTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *ROOT.glob("examples/**/*.md")])


def section(name: str) -> str:
    """The text below one heading of the README."""
    return README.partition(f"\n## {name}\n")[2].partition("\n## ")[0]


def rows(text: str) -> list[list[str]]:
    """The cells of every line of a table, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_it_is_short_and_answers_in_this_order() -> None:
    assert len(README.splitlines()) <= 150
    assert re.findall(r"^## (.*)$", README, re.M) == ORDER
    assert "docs/replay.gif" in README.partition("## Install")[0]


def test_it_keeps_the_two_commands() -> None:
    assert {"make train", "make test"} <= set(re.findall(r"^make \w+", section("Install"), re.M))


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_that_are_linked_exist(text: Path) -> None:
    links = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text.read_text(encoding="utf-8"))
    assert [link for link in links if not (text.parent / link).exists()] == []


def test_its_table_of_rooms_is_the_listing() -> None:
    listed = {
        row[0].strip("`"): set(re.findall(r"`(\w+)`", row[1])) for row in rows(section("Rooms"))
    }
    listed.pop("room")
    levels = {room: set(names) for room, names in rooms().items()}
    assert listed == {room: levels[room] for room in listed}
    assert set(levels) - set(listed) == {"trainer", "logger"}


def test_its_results_are_those_of_the_page_of_results() -> None:
    page = rows((ROOT / "docs" / "results.md").read_text(encoding="utf-8"))
    known = {tuple(row[1:6]) for row in page}
    head, *measured = rows(section("Results"))
    assert head[1:] == ["finished", "T_90", "x", "T_100", "x"] and 1 <= len(measured) <= 6
    assert [row[0] for row in measured if tuple(row[1:]) not in known] == []


@pytest.mark.slow
def test_its_commands_compose() -> None:
    commands = re.findall(r"^marl-clean (?:train|evaluate|watch) ([^#\n]*)", README, re.M)
    assert len(commands) >= 4
    for command in commands:
        settings = [word for word in command.split() if word != "-m"]
        for setting in settings:
            key, _, values = setting.partition("=")
            for value in values.split(","):
                if key.lstrip("+") in groups():
                    compose_config([f"{key}={value}"])
        compose_config([re.sub(r",.*", "", setting) for setting in settings])


@pytest.mark.long
@pytest.mark.usefixtures("unchecked")
def test_its_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    [program] = re.findall(r"```python\n(.*?)```", section("One minute"), re.S)
    shorter = program.replace("houses=20", "houses=2, max_steps=30")
    assert shorter != program
    (tmp_path / "program.py").write_text(shorter)
    monkeypatch.chdir(tmp_path)
    runpy.run_path("program.py")
