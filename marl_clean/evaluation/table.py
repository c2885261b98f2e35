"""The table of an evaluation in the terminal: one row per policy."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from marl_clean.evaluation.records import Entry, sample

YARDSTICK = "nearest_unknown"
NONE = "-"
WIDTH = 180  # characters that the widest table needs
CAPTION = (
    "Means over houses (of a plan: over starts), with 95 % intervals. A house not finished counts\n"
    "as its max_steps. Learned policies take a share of evaluation.epsilon random actions.\n"
    f"x: the mean as a multiple of {YARDSTICK}'s. Coverage is that at max_steps."
)


def output() -> Console:
    """Standard output, as wide as the table needs: a long line is better than a cut number."""
    return Console(width=max(Console().width, WIDTH))


def make_table(entries: Sequence[Entry]) -> Table:
    """Rows in the order of `entries`; each is compared with the yardstick on its own houses.

    The table of an external task holds returns alone.
    """
    first = entries[0]
    if "T_100" not in first["summary"]:
        return make_returns_table(entries)
    # The pooled entry of several seeds has every house once per seed.
    count = min(len(entry["houses"]) for entry in entries)
    table = Table(
        title=f"{count} houses ({first['house_set']}), {first['n_agents']} robots",
        caption=CAPTION,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    several = len({entry["house_set"] for entry in entries}) > 1
    if several:
        table.add_column("houses", overflow="fold")
    table.add_column("policy", no_wrap=True)
    spills = "spill_delay" in first["summary"]
    titles = ["finished", "T_90", "x", "T_100", "x", "coverage", "redundancy"]
    for title in titles + ["spill_delay"] * spills:
        table.add_column(title, justify="right", no_wrap=True)
    for entry in entries:
        yardstick = next((other for other in entries if is_yardstick(other, entry)), None)
        cells = [entry["policy"], *row_of(entry, yardstick)]
        table.add_row(*([entry["house_set"], *cells] if several else cells))
    return table


def make_returns_table(entries: Sequence[Entry]) -> Table:
    """Rows in the order of `entries`, for an external task, which has no cells."""
    first = entries[0]
    count = min(len(entry["houses"]) for entry in entries)
    table = Table(
        title=f"{count} episodes of {first['house_set']}, {first['n_agents']} agents",
        caption="Mean return, the sum over agents, with 95 % interval.",
        box=box.SIMPLE_HEAD,
    )
    for title in ("policy", "return"):
        table.add_column(title, no_wrap=True)
    for entry in entries:
        table.add_row(entry["policy"], interval(entry["summary"]["return"]))
    return table


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
        ratio_to(yardstick, entry, "T_90"),
        interval(summary["T_100"]),
        ratio_to(yardstick, entry, "T_100"),
        percent(summary["coverage"]["mean"]),
        f"{summary['redundancy']['mean']:.2f}",
        *([interval(summary["spill_delay"])] if "spill_delay" in summary else []),
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
    mean, baseline = (np.mean(sample([e["houses"]], measure)) for e in (entry, yardstick))
    return f"{mean / baseline:.2f}" if baseline else NONE
