"""The table of the headroom page is what `marl-clean headroom` measured and `docs/tables` keeps."""

import csv
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
STORED, LOSSES = (DOCS / "tables" / f"headroom{name}.csv" for name in ("", "_losses"))
REACHES = ("3", "5", "7", "full")


def stored_rows(path: Path = STORED) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def number(row: dict[str, str], name: str, digits: int = 2) -> str:
    value, low, high = (f"{float(row[name + end]):.{digits}f}" for end in ("", "_low", "_high"))
    return f"{value} [{low}, {high}]"


def table() -> list[str]:
    """A line for each house and team."""
    rows = stored_rows()
    found = {
        (row["house"], row["n_agents"], row["reach"], row["memory"], row["assignment"]): row
        for row in rows
    }
    heads = ["house", "robots", "private", "shared", *REACHES[:-1], "full", "targets"]
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for house, team in dict.fromkeys((row["house"], row["n_agents"]) for row in rows):
        times = [found[house, team, "", memory, "none"] for memory in ("private", "shared")]
        cells = [house, team, *(number(row, "T_90", 1) for row in times)]
        merged = [found[house, team, reach, "merged", "none"] for reach in REACHES]
        cells += [number(row, "T_90_headroom") for row in merged]
        assigned = found[house, team, "7", "merged", "hungarian"]
        cells.append(number(assigned, "T_90_coordination"))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def loss_table() -> list[str]:
    """A line for each team and reach, a column for each share of maps that is lost."""
    rows = [r for r in stored_rows(LOSSES) if (r["memory"], r["assignment"]) == ("merged", "none")]
    factors = {(r["n_agents"], r["reach"], r["channel"]): number(r, "T_90_headroom") for r in rows}
    channels = list(dict.fromkeys(row["channel"] for row in rows))
    lines = [f"| robots | reach | {' | '.join(channels)} |", f"|{'---|' * (2 + len(channels))}"]
    for team, reach in sorted({(row["n_agents"], row["reach"]) for row in rows}):
        cells = [team, reach, *(factors[team, reach, channel] for channel in channels)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def test_the_page_shows_what_is_stored() -> None:
    page = (DOCS / "headroom.md").read_text(encoding="utf-8").splitlines()
    for lines, houses in ((table(), 15), (loss_table(), 4)):
        assert len(lines) == 2 + houses
        start = page.index(lines[0])
        assert page[start : start + len(lines)] == lines


def test_what_the_page_says_of_the_table_holds() -> None:
    rows = stored_rows()
    merged = [row for row in rows if row["memory"] == "merged"]
    cells = [row for row in merged if row["assignment"] == "none"]
    factors = [float(row["T_90_headroom"]) for row in cells]
    assert len(cells) == 60 and all(float(row["T_90_headroom_low"]) > 1 for row in cells)
    assert f"{min(factors):.2f} to {max(factors):.2f}" == "1.47 to 3.40"
    gains = [float(row["T_90_coordination"]) for row in merged if row["assignment"] != "none"]
    clear = [row for row in merged if float(row["T_90_coordination_low"]) > 1]
    assert (f"{min(gains):.2f}", f"{max(gains):.2f}", len(clear)) == ("0.98", "1.11", 40)
