"""`statistics.csv`: every number of a comparison's statistics, a line each.

| column | is |
|---|---|
| `row`, `house_set`, `n_agents`, `houses`, `seeds` | the row; `seeds` is their number, empty for a planner |
| `statistic` | `mean`, `median`, `iqm`, `optimality_gap`, `improvement`, `recovered`, `gap` or `protocols` |
| `measure` | what it is of: `T_90`, `score`, ... |
| `against` | the row that it compares with, `silent / oracle` for two; may be empty |
| `value`, `low`, `high` | the number and its 95 % interval; empty where there is none |
"""  # noqa: E501

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

COLUMNS = ("row", "house_set", "n_agents", "houses", "seeds")
NUMBER = ("statistic", "measure", "against", "value", "low", "high")
Row = Mapping[str, Any]


def to_flat(statistics: Sequence[Row]) -> str:
    """The text of statistics.csv."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, *NUMBER])
    for row in statistics:
        about = [row[name] for name in COLUMNS[:-1]]
        for statistic, measure, against, number in _numbers(row):
            low, high = number["ci95"] or (None, None)
            line = [*about, len(row["seeds"]) or None, statistic, measure, against]
            writer.writerow([*line, number["value"], low, high])
    return text.getvalue()


def _numbers(row: Row) -> Iterator[tuple[str, str, str | None, Row]]:
    """(statistic, measure, against, number) of each."""
    for measure, kinds in row["aggregates"].items():
        for statistic, number in kinds.items():
            yield statistic, measure, None, number
    better = row.get("improvement", {})
    for measure in sorted(better.keys() - {"over"}):
        yield "improvement", measure, better["over"], better[measure]
    recovered = row.get("recovered", {})
    for measure in sorted(recovered.keys() - {"silent", "oracle", "seeds"}):
        both = f"{recovered['silent']} / {recovered['oracle']}"
        yield "recovered", measure, both, recovered[measure]
        if recovered[measure]["gap"] is not None:
            yield "gap", measure, both, recovered[measure]["gap"]
    if "protocols" in row:
        share = row["protocols"]
        yield "protocols", share["measure"], share["silent"], share
