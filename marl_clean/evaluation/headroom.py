"""What knowing more is worth to planners: private, merged and shared maps, coordinated targets.

No policy is trained. `nearest_unknown` plays the same houses from the same starts under each kind
of map and each assignment of targets, so that two numbers differ by what the robots knew alone:

    headroom      mean T under private maps and no assignment / mean T
    coordination  mean T under the same maps and no assignment / mean T

Maps are merged by robots in contact, over the edges that their channel lets through: a map that
is lost does not arrive in that step. Assignment knows all robots and their targets, however far:
it is a coordinator's, and stands for what messages about intentions could win. Nothing here needs
torch; `planner_play` plays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from marl_clean.errors import BadInput
from marl_clean.evaluation.ratios import ratio_of_means
from marl_clean.evaluation.records import House, sample, share_reached
from marl_clean.evaluation.resampling import Interval
from marl_clean.evaluation.statistics import estimate
from marl_clean.settings import Assignment, Memory

MEASURES = ("T_90", "T_100")
FULL = "full"
NONE = "-"
WIDTH = 200  # characters that the table needs: a long line is better than a cut number
ASSIGNED = tuple(assignment.value for assignment in Assignment if assignment is not Assignment.NONE)
CAPTION = (
    "T_90 of nearest_unknown, means with 95 % intervals over houses; a house not finished counts\n"
    "as its max_steps. private/merged: how many times sooner with maps of others within reach, on\n"
    "the same houses and starts; none/greedy: how many times sooner by assigned targets."
)

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """One place of the grid.

    Attributes:
        place: the houses, such as 14x14.
        n_agents: number of robots.
        reach: contact up to so many cells, or `full`; None where it plays no part.
        channel: what maps cross, such as perfect; None where it plays no part.
    """

    place: str
    n_agents: int
    reach: int | str | None = None
    channel: str | None = None


@dataclass(frozen=True)
class Played:
    """One kind of map and assignment in the houses of a cell."""

    cell: Cell
    memory: Memory
    assignment: Assignment
    records: Sequence[House]

    def values(self, measure: str) -> Float[np.ndarray, "1 house"]:
        """A measure house by house; a time not reached is `max_steps`."""
        return sample([self.records], measure)


def rows_of(plays: Sequence[Played]) -> list[dict[str, Any]]:
    """One row a play: what it took, and what it gains.

    `house`, `n_agents`, `reach`, `channel`, `memory`, `assignment`, `houses`, `finished`, then of
    T_90 and T_100 the mean, `_headroom` and `_coordination`, each with `_low` and `_high`: 95 %
    bootstrap intervals over houses, the same houses on both sides of a ratio. Raises BadInput
    where a play to compare with is missing.
    """
    return [_row(item, plays) for item in plays]


def _row(item: Played, plays: Sequence[Played]) -> dict[str, Any]:
    cell = item.cell
    row: dict[str, Any] = {
        "house": cell.place,
        "n_agents": cell.n_agents,
        "reach": cell.reach,
        "channel": cell.channel,
        "memory": item.memory.value,
        "assignment": item.assignment.value,
        "houses": len(item.records),
        "finished": share_reached([item.records], "T_100"),
    }
    private = played_in(plays, Cell(cell.place, cell.n_agents), Memory.PRIVATE, Assignment.NONE)
    alone = played_in(plays, cell, item.memory, Assignment.NONE)
    for measure in MEASURES:
        values = item.values(measure)
        mean = estimate(values)
        row |= _columns(measure, Interval(mean.mean, mean.ci95))
        for name, other in (("headroom", private), ("coordination", alone)):
            gain = ratio_of_means(other.values(measure), values)
            row |= _columns(f"{measure}_{name}", gain)
    return row


def played_in(
    plays: Sequence[Played], cell: Cell, memory: Memory, assignment: Assignment
) -> Played:
    """The play of a cell. Raises BadInput where there is none."""
    for item in plays:
        if (item.cell, item.memory, item.assignment) == (cell, memory, assignment):
            return item
    raise BadInput(f"headroom: {memory} maps with assignment {assignment} were not played")


def _columns(name: str, number: Interval) -> dict[str, float | None]:
    low, high = number.ci95 or (None, None)
    return {name: number.value, f"{name}_low": low, f"{name}_high": high}


def merged_cells(rows: Sequence[Row]) -> list[Row]:
    """The rows of merged maps without assignment: one for each cell of the grid."""
    return [row for row in rows if (row["memory"], row["assignment"]) == ("merged", "none")]


def row_in(rows: Sequence[Row], cell: Row, memory: str, assignment: str) -> Row:
    """The row of the same houses and robots; of merged maps that of the same reach and channel."""
    same = ["house", "n_agents", *(("reach", "channel") if memory == "merged" else ())]
    return next(
        row
        for row in rows
        if (row["memory"], row["assignment"]) == (memory, assignment)
        and all(row[key] == cell[key] for key in same)
    )


def make_headroom_table(rows: Sequence[Row]) -> Table:
    """A line for each cell, of T_90."""
    cells = merged_cells(rows)
    several = len({cell["channel"] for cell in cells}) > 1
    table = Table(
        title=f"headroom of T_90, {cells[0]['houses']} houses a cell",
        caption=CAPTION,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("house", no_wrap=True)
    heads = ["robots", "reach", *(["channel"] if several else []), "private", "merged", "shared"]
    heads += ["private/merged", "private/shared", *(f"none/{name}" for name in ASSIGNED)]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    before: tuple[str, int] | None = None
    for cell in cells:
        private, shared = (row_in(rows, cell, memory, "none") for memory in ("private", "shared"))
        line = [cell["house"], str(cell["n_agents"]), str(cell["reach"])]
        line += [cell["channel"]] if several else []
        line += [number_of(row, "T_90", 1) for row in (private, cell, shared)]
        line += [number_of(row, "T_90_headroom", 2) for row in (cell, shared)]
        assigned = [row_in(rows, cell, "merged", name) for name in ASSIGNED]
        line += [number_of(row, "T_90_coordination", 2) for row in assigned]
        if before is not None and before != (cell["house"], cell["n_agents"]):
            table.add_section()
        before = cell["house"], cell["n_agents"]
        table.add_row(*line)
    return table


def number_of(row: Row, name: str, digits: int) -> str:
    """`value [low, high]`, or a dash where there is no value."""
    ends = [row[key] for key in (name, f"{name}_low", f"{name}_high")]
    if None in ends:
        return NONE
    value, low, high = (f"{end:.{digits}f}" for end in ends)
    return f"{value} [{low}, {high}]"


def advice(rows: Sequence[Row]) -> str:
    """What the table says of training, in two lines."""
    cells = merged_cells(rows)
    poor = sum(not is_gain(cell, "T_90_headroom") for cell in cells)
    assigned = [row for row in rows if row["memory"] == "merged" and row["assignment"] != "none"]
    intent = sum(is_gain(row, "T_90_coordination") for row in assigned)
    maps = f"in {poor} of {len(cells)} cells nothing to win: do not train there"
    return (
        f"maps of others: {maps if poor else f'something to win in all {len(cells)} cells'}\n"
        f"targets of others, maps merged: a clear gain in {intent} of {len(assigned)} plays"
    )


def is_gain(row: Row, name: str) -> bool:
    """Whether the interval of a factor lies above 1."""
    return row[f"{name}_low"] is not None and row[f"{name}_low"] > 1
