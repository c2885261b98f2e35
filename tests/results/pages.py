"""Whether the tables of pages are what the stored tables say, to the printed digit.

    python -m tests.results.pages          # a line for each cell that is not; exit code 1

A line `<!-- stored: NAME LAYOUT [default row] -->` above a table of a page names the stored table
and how its cells are made of it; the README's results are named in `README_TABLE`. A row or column
that the layout cannot make is a fault too.
"""

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from tests.results.stored import ROOT, Table, read

README = ROOT / "README.md"
PAGES = [ROOT / "docs" / "results.md", ROOT / "docs" / "scenarios.md"]
MARK = re.compile(r"^\s*<!-- stored: (\w+) (\w+) ?(.*?) -->$")
README_TABLE = ("any_house", "measures", "any_house")  # the first table below "## Results"
YARDSTICK = "nearest_unknown"
Cell = Callable[[Table, str, str, str], str]  # of a table, the row, its default row, the column


@dataclass(frozen=True)
class Shown:
    """A table of a page: where it is, what it is made of, and its rows with the titles first."""

    line: int
    name: str
    layout: str
    default: str
    rows: list[list[str]]


def tables_in(text: str) -> Iterator[Shown]:
    """The tables of a page that have a mark."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if (mark := MARK.match(line)) is not None:
            start = next(i for i in range(number + 1, len(lines)) if lines[i].strip())
            yield Shown(start + 1, *mark.groups(), rows=rows_from(lines, start))


def readme_table(text: str) -> Shown:
    """The README's table of results."""
    lines = text.splitlines()
    start = lines.index("## Results")
    start = next(i for i in range(start, len(lines)) if lines[i].startswith("|"))
    return Shown(start + 1, *README_TABLE, rows=rows_from(lines, start))


def rows_from(lines: list[str], start: int) -> list[list[str]]:
    """The cells of the table that begins at a line, without the rule below its titles."""
    rows = []
    for line in lines[start:]:
        if not line.strip().startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
    assert len(rows) > 2 and set("".join(rows[1])) <= set("-: "), f"no table: {lines[start]!r}"
    return [rows[0], *rows[2:]]


def faults(shown: Shown, table: Table) -> Iterator[str]:
    """A line for each cell that is not what the stored table says."""
    titles, *rows = shown.rows
    measures = [named(titles, place) for place in range(len(titles))]
    for number, row in enumerate(rows):
        if plain(row[0]) in table.not_stored:
            continue
        for place in range(1, len(row)):
            try:
                expected = LAYOUTS[shown.layout](
                    table, plain(row[0]), shown.default, measures[place]
                )
            except KeyError as error:
                expected = f"nothing: {error} is not stored"
            if row[place] != expected:
                where = f"line {shown.line + 2 + number}: {row[0]}, {measures[place]}"
                yield f"{where}: {row[place]!r}, stored: {expected!r}"


def named(titles: list[str], place: int) -> str:
    """A column's title; an `x` belongs to the time before it."""
    return f"{titles[place - 1]}, x" if titles[place] == "x" else plain(titles[place])


def plain(text: str) -> str:
    """A cell without code and bold marks."""
    return text.replace("**", "").replace("`", "")


def share(value: float) -> str:
    """A share as per cent; 100 % only where nothing is missing."""
    if value == 1:
        return "100 %"
    return f"{min(100 * value, 99.9):.1f} %"


def steps(time: Mapping[str, float]) -> str:
    return f"{time['mean']:.1f} [{time['low']:.1f}, {time['high']:.1f}]"


def multiples(table: Table, row: str, place: str, n_agents: int = 2) -> list[dict[str, float]]:
    """T_90 and T_100 of a row as multiples of the yardstick's means."""
    own, planner = (table.entry(name, place, n_agents) for name in (row, YARDSTICK))
    return [
        {name: value / planner[time]["mean"] for name, value in own[time].items() if value}
        for time in ("T_90", "T_100")
    ]


def measures(table: Table, row: str, default: str, column: str) -> str:
    """Rows `PLACE` or `PLACE: ROW`; columns finished, T_90, x, T_100, x, coverage."""
    place, _, name = row.partition(": ")
    place, name = place.partition(",")[0], name or default
    entry = table.entry(name, place)
    if column == "finished":
        return share(entry["finished"])
    if column == "best planner, x":
        return " and ".join(f"{value:.2f}" for value in best_of(read("planners"), place))
    time, _, ratio = column.partition(", ")
    if ratio:
        return f"{entry[time]['mean'] / table.entry(YARDSTICK, place)[time]['mean']:.2f}"
    return steps(entry[time])


def policies(table: Table, row: str, default: str, column: str) -> str:
    """Rows are policies, all in the default place; columns as of `measures`."""
    if column == "coverage at max_steps":
        return share(table.entry(row, default)["coverage"])
    return measures(table, f"{default}: {row}", default, column)


def intervals(table: Table, row: str, default: str, column: str) -> str:
    """A column a place: `x [..] / x [..]` of T_90 and T_100, and the share finished below 100 %."""
    parts = (
        f"{x['mean']:.2f} [{x['low']:.2f}, {x['high']:.2f}]" for x in multiples(table, row, column)
    )
    return " / ".join(parts) + below_all(table.entry(row, column)["finished"], ", {}")


def pairs(table: Table, row: str, default: str, column: str) -> str:
    """A column a place: `x / x`, and the share finished below 100 % in brackets."""
    if row == "random":
        return f"{multiples(table, row, column)[0]['mean']:.2f}"
    text = " / ".join(f"{x['mean']:.2f}" for x in multiples(table, row, column))
    return text + below_all(table.entry(row, column)["finished"], " ({})")


def planners(table: Table, row: str, default: str, column: str) -> str:
    """As `pairs`, the yardstick in steps, and the least of each time."""
    if row == f"{YARDSTICK}, in steps":
        entry = table.entry(YARDSTICK, column)
        return " / ".join(f"{entry[time]['mean']:.1f}" for time in ("T_90", "T_100"))
    if row == "the best of all":
        return " / ".join(f"{value:.2f}" for value in best_of(table, column))
    text = " / ".join(f"{x['mean']:.2f}" for x in multiples(table, row, column))
    return text + below_all(table.entry(row, column)["finished"], ", {}")


def teams(table: Table, row: str, default: str, column: str) -> str:
    """A column a team size: mean T_100 with its interval; `the same` as the first row's."""
    n_agents = int(column.split()[0])
    time, first = (table.entry(name, default, n_agents)["T_100"] for name in (row, YARDSTICK))
    return "the same" if time == first and row != YARDSTICK else steps(time)


def plans(table: Table, row: str, default: str, column: str) -> str:
    """A row a plan: its cells and size, share finished, multiples, the coverage of `random`."""
    entry = table.entry(default, row)
    if column == "cells, in a plan of":
        return f"{entry['cells']:,}, {entry['rows']} x {entry['cols']}"
    if column == "finished":
        return f"{100 * entry['finished']:.0f} %"
    if column == "random":
        return f"{100 * table.entry('random', row)['coverage']:.0f} %"
    time = column.removesuffix(", x")
    return f"{entry[time]['mean'] / table.entry(YARDSTICK, row)[time]['mean']:.2f}"


def best_of(table: Table, place: str) -> list[float]:
    """The least multiples of any planner, of T_90 and of T_100."""
    every = [multiples(table, row, place) for row in table.rows()]
    return [min(row[i]["mean"] for row in every) for i in (0, 1)]


def below_all(finished: float, text: str) -> str:
    """The share finished, in whole per cent, within a text where it is below 100 %."""
    return "" if finished >= 0.995 else text.format(f"{100 * finished:.0f} %")


LAYOUTS: dict[str, Cell] = {
    layout.__name__: layout
    for layout in (measures, policies, intervals, pairs, planners, teams, plans)
}


def all_faults(readme: str, pages: Mapping[str, str]) -> list[str]:
    """Every fault of the README and of pages, their texts by name."""
    shown = readme_table(readme)
    lines = [f"{README.name}: {line}" for line in faults(shown, read(shown.name))]
    for name, page in pages.items():
        for shown in tables_in(page):
            lines += [f"{name}: {line}" for line in faults(shown, read(shown.name))]
    return lines


def texts() -> dict[str, str]:
    """The pages by name."""
    return {page.name: page.read_text(encoding="utf-8") for page in PAGES}


def main() -> int:
    """Print every fault."""
    lines = all_faults(README.read_text(encoding="utf-8"), texts())
    print("\n".join(lines) or "all tables with a record are as it says")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
