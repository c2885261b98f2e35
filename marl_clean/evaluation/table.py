"""The table of an evaluation in the terminal: one row a policy."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from marl_clean.evaluation.records import Entry, sample

YARDSTICK = "nearest_unknown"
NONE = "-"


def make_table(entries: Sequence[Entry]) -> Table:
    """Rows in the order given, grouped by the set of houses; means with 95 % intervals."""
    first = entries[0]
    title = f"{len(first['houses'])} houses, {first['n_agents']} robots"
    table = Table(title=title, caption=CAPTION)
    several = len({entry["house_set"] for entry in entries}) > 1
    if several:
        table.add_column("houses", overflow="fold")
    table.add_column("policy", overflow="fold")
    for title in ("finished", "T_90", "T_100", "T_90 ratio", "T_100 ratio", "coverage", "redund."):
        table.add_column(title, justify="right")
    for entry in entries:
        yardstick = next((other for other in entries if is_yardstick(other, entry)), None)
        cells = [entry["policy"], *row_of(entry, yardstick)]
        table.add_row(*([entry["house_set"], *cells] if several else cells))
    return table


CAPTION = (
    "mean [95 % interval]; a house not finished counts as its max_steps; "
    f"ratio: of the mean to {YARDSTICK}'s; coverage: at max_steps"
)


def is_yardstick(candidate: Entry, entry: Entry) -> bool:
    """Whether `candidate` is the planner without assignment, on the houses of `entry`."""
    same_houses = candidate["house_set"] == entry["house_set"]
    return same_houses and candidate["policy"] == YARDSTICK


def row_of(entry: Entry, yardstick: Entry | None) -> list[str]:
    """The cells of one policy, without its name."""
    summary = entry["summary"]
    return [
        percent(summary["T_100"]["reached"]),
        interval(summary["T_90"]),
        interval(summary["T_100"]),
        *(ratio_to(yardstick, entry, measure) for measure in ("T_90", "T_100")),
        percent(summary["coverage"]["mean"]),
        f"{summary['redundancy']['mean']:.2f}",
    ]


def percent(share: float) -> str:
    """A share as per cent; 100.0 % only when nothing is missing."""
    rounded = f"{100 * share:.1f}"
    return "99.9 %" if rounded == "100.0" and share < 1 else f"{rounded} %"


def interval(measure: Mapping[str, Any]) -> str:
    """`mean [low, high]`, or a dash where there is no value."""
    if measure["mean"] is None:
        return NONE
    low, high = measure["ci95"]
    return f"{measure['mean']:.1f} [{low:.1f}, {high:.1f}]"


def ratio_to(yardstick: Entry | None, entry: Entry, measure: str) -> str:
    """A policy's mean as a multiple of the yardstick's on the same houses."""
    if yardstick is None:
        return NONE
    ours, theirs = (sample([one["houses"]], measure).mean() for one in (entry, yardstick))
    return f"{ours / theirs:.2f}" if theirs else NONE
