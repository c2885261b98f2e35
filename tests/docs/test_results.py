"""The results of README and pages are what is stored, and a changed digit is seen."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from marl_clean.evaluation.records import MEASURES, make_entry, write_entries
from tests.results import pages, store, stored

README = pages.README.read_text(encoding="utf-8")
PAGES = pages.texts()
PAGE = PAGES["results.md"]
OF_PAGES = [shown for page in PAGES.values() for shown in pages.tables_in(page)]
SHOWN = [pages.readme_table(README), *OF_PAGES]
# Sections whose tables were measured before records were kept.
NOT_STORED = {
    "The paper's own designs": 1,
    "Does talking help?": 3,
    "Fine-tuning at home": 1,
}


def of(shown: pages.Shown) -> str:
    return f"{shown.name}-{shown.line}"


def test_tables_are_what_is_stored() -> None:
    assert pages.all_faults(README, PAGES) == []


@pytest.mark.parametrize("shown", SHOWN, ids=of)
def test_a_changed_digit_is_seen_in_every_cell(shown: pages.Shown) -> None:
    table = stored.read(shown.name)
    for number, row in enumerate(shown.rows[1:], start=1):
        if pages.plain(row[0]) in table.not_stored:
            continue
        for place in range(1, len(row)):
            digits = [match.start() for match in re.finditer(r"\d", row[place])]
            for at in digits or [0]:  # a cell may say `the same`
                digit = str((int(row[place][at]) + 1) % 10) if digits else "?"
                changed = row[place][:at] + digit + row[place][at + 1 :]
                rows = [list(cells) for cells in shown.rows]
                rows[number][place] = changed
                (fault,) = pages.faults(replace(shown, rows=rows), table)
                assert repr(changed) in fault and row[0] in fault


def test_a_changed_digit_of_the_readme_and_of_a_page_is_seen_in_the_whole_text() -> None:
    for wrong_readme, wrong_page in (
        (README.replace("93.3 [91.1", "93.2 [91.1"), PAGE),
        (README, PAGE.replace("| 1.80 / 3.02 (29 %) |", "| 1.80 / 3.02 (28 %) |")),
    ):
        assert (wrong_readme, wrong_page) != (README, PAGE)
        assert len(pages.all_faults(wrong_readme, PAGES | {"results.md": wrong_page})) == 1


def test_a_row_that_is_not_stored_is_seen() -> None:
    shown = SHOWN[0]
    rows = [*shown.rows, ["12x12", *shown.rows[1][1:]]]
    found = list(pages.faults(replace(shown, rows=rows), stored.read(shown.name)))
    assert len(found) == 5 and all("is not stored" in fault for fault in found)


def test_every_table_is_stored_or_listed_as_one_that_is_not() -> None:
    unmarked: dict[str, int] = {}
    for section in PAGE.split("\n## ")[1:]:
        title, rest = section.split("\n", 1)
        count = len(re.findall(r"^ *\|[-| ]+\|$", rest, re.M)) - rest.count("<!-- stored: ")
        if count:
            unmarked[title] = count
    assert unmarked == NOT_STORED
    for shown in SHOWN:
        rows = {pages.plain(row[0]) for row in shown.rows[1:]}
        assert rows >= {*stored.read(shown.name).not_stored} != rows
    names = {path.stem for path in stored.FOLDER.glob("*.json")}
    assert names == {shown.name for shown in SHOWN}


def house(seed: int, time: int | None) -> dict:
    record = {measure: 1.0 for measure in MEASURES if not measure.endswith("certify")}
    record |= {f"bound_{name}": 10 for name in ("90", "95", "99", "100")}
    record |= {"rows": 10, "cols": 10, "free_cells": 48}
    return record | {"seed": seed, "max_steps": 250, "T_100": time, "T_90": time}


@pytest.mark.slow
def test_what_is_stored_is_what_was_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed, times in enumerate(([40, 60], [50, None])):
        houses = [house(number, time) for number, time in enumerate(times)]
        yardstick = [house(number, 50) for number in range(2)]
        write_entries(
            tmp_path / f"{seed}.json",
            [
                make_entry(f"mine-{seed}", "test", "ab" * 32, 0.0, 2, houses),
                make_entry(f"mine-{seed}", "test 8x8", "ab" * 32, 0.0, 2, houses),
                make_entry("nearest_unknown", "test", "cd" * 32, 0.0, 2, yardstick),
            ],
        )
    monkeypatch.setattr(stored, "FOLDER", tmp_path)
    files = f"{tmp_path / '0.json'},{tmp_path / '1.json'}"
    about = ["--about", "a", "--command", "c"]
    store.main(["mine", f"a=b={files}", *about, "--places", "10x10"])
    table = stored.read("mine")
    assert table.rows() == ["a=b", "nearest_unknown"]
    entry = table.entry("a=b", "10x10")
    assert (entry["seeds"], entry["houses"], entry["finished"]) == (2, 2, 0.75)
    assert entry["T_100"]["mean"] == (40 + 60 + 50 + 250) / 4
    assert entry["T_100"]["low"] < 100 < entry["T_100"]["high"]
    assert pages.measures(table, "10x10", "a=b", "T_100, x") == "2.00"
