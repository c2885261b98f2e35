"""What was measured, as data: one row a policy, for Python users and their notebooks."""

import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, overload

from rich.console import Console

from marl_clean.errors import BadInput
from marl_clean.evaluation.records import Entry
from marl_clean.evaluation.table import WIDTH, make_table

if TYPE_CHECKING:
    from pandas import DataFrame

Row = dict[str, Any]


class Table(Sequence[Row]):
    """The rows of an evaluation: a policy on a set of houses each, in the order measured.

        >>> import marl_clean
        >>> table = marl_clean.evaluate(planner="nearest_unknown", houses=2)
        >>> [row["policy"] for row in table], table[0]["finished"]
        (['nearest_unknown'], 1.0)
        >>> len(table.houses)
        2

    A row has `policy`, `house_set`, `n_agents`, `epsilon`, the share of houses `finished` where
    there are houses, and for each measure its mean (`T_100`) and 95 % interval (`T_100_low`,
    `T_100_high`); None where it has no value. `print` shows the table of the commands.

    Attributes:
        entries: the same as evaluation.json has it, house by house.
        differences: of a comparison, each setting's paired difference to the reference; empty
            otherwise.
        statistics: of a comparison, each row's interquartile means, optimality gaps, profiles and
            probability of improvement over the reference, with 95 % intervals; as
            `<out>_statistics.json` of the command has them.
    """

    def __init__(
        self,
        entries: Sequence[Entry],
        differences: Sequence[Row] = (),
        statistics: Sequence[Row] = (),
    ) -> None:
        self.entries = list(entries)
        self.differences = list(differences)
        self.statistics = list(statistics)
        self.rows = [row_of(entry) for entry in self.entries]

    @property
    def houses(self) -> list[Row]:
        """One row for each policy and house, with every measure of that episode."""
        return [
            {"policy": entry["policy"], "house_set": entry["house_set"], **house}
            for entry in self.entries
            for house in entry["houses"]
        ]

    def to_pandas(self) -> "DataFrame":
        """Return the rows as a pandas DataFrame. Raises BadInput where pandas is not installed.

        >>> import marl_clean
        >>> frame = marl_clean.evaluate(planner="random", houses=2).to_pandas()
        >>> frame.loc[0, "policy"]
        'random'
        """
        return frame_of(self.rows)

    @overload
    def __getitem__(self, index: int) -> Row: ...

    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...

    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __str__(self) -> str:
        text = io.StringIO()
        console = Console(file=text, width=WIDTH)
        for place in dict.fromkeys((e["house_set"], e["n_agents"]) for e in self.entries):
            same = [e for e in self.entries if (e["house_set"], e["n_agents"]) == place]
            console.print(make_table(same))
        return text.getvalue()

    def __repr__(self) -> str:
        return f"Table({', '.join(entry['policy'] for entry in self.entries)})"


def frame_of(rows: Sequence[Row]) -> "DataFrame":
    """Rows as a pandas DataFrame. Raises BadInput where pandas is not installed."""
    try:
        from pandas import DataFrame
    except ModuleNotFoundError:
        needs = "to_pandas: needs pandas, which is not installed; pip install pandas"
        raise BadInput(needs) from None
    return DataFrame(rows)


def row_of(entry: Entry) -> Row:
    """One entry of evaluation.json without its houses, its summary flat."""
    row = {name: entry[name] for name in ("policy", "house_set", "n_agents", "epsilon")}
    if "T_100" in entry["summary"]:
        row["finished"] = entry["summary"]["T_100"]["reached"]
    for name, measure in entry["summary"].items():
        low, high = measure["ci95"] or (None, None)
        row |= {name: measure["mean"], f"{name}_low": low, f"{name}_high": high}
    return row
