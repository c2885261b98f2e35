"""`marl_clean.headroom`: where a message can pay, as a table."""

import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

from matplotlib.figure import Figure
from rich.console import Console

from marl_clean.commands import headroom as command
from marl_clean.commands._headroom_settings import PREFIX, HeadroomSettings, make_plan
from marl_clean.commands.checks import check_out
from marl_clean.evaluation.headroom import WIDTH, make_headroom_table
from marl_clean.python.keywords import Settings, overrides_of, value_text
from marl_clean.python.table import Row, frame_of
from marl_clean.report.headroom import draw_headroom

if TYPE_CHECKING:
    from pandas import DataFrame

OWN = tuple(HeadroomSettings.__dataclass_fields__)


class Headroom(Sequence[Row]):
    """The rows of `headroom`: a kind of map and an assignment in the houses of a cell each.

    `house`, `n_agents`, `reach`, `channel`, `memory`, `assignment`, `houses`, `finished`; of `T_90`
    and `T_100` the mean, `T_90_headroom` (the time under private maps and no assignment divided by
    this) and `T_90_coordination` (the time without assignment divided by this), each with `_low`
    and `_high`, the ends of its 95 % interval. `print` shows the table of the command.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = list(rows)

    def to_pandas(self) -> "DataFrame":
        """Return the rows as a pandas DataFrame. Raises BadInput where pandas is not installed."""
        return frame_of(self.rows)

    def figure(self) -> Figure:
        """Return the heat map as a Matplotlib figure; notebooks show it."""
        return draw_headroom(self.rows)

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
        Console(file=text, width=WIDTH).print(make_headroom_table(self.rows))
        return text.getvalue()

    def __repr__(self) -> str:
        return f"Headroom({len(self.rows)} rows)"


def headroom(settings: Settings = None, /, **keywords: Any) -> Headroom:
    """Measure what maps and targets of others are worth to planners, and return a row a play.

    As `marl-clean headroom` does; files are written only with `out=`. `sides`, `robots`, `reaches`,
    `losses` and `houses` are those of `headroom.`; for other keywords see `train`.

        >>> import marl_clean
        >>> table = marl_clean.headroom(sides=[7], robots=[2], reaches=[2, "full"], houses=4)
        >>> [(row["memory"], row["reach"]) for row in table][::3]
        [('private', None), ('shared', None), ('merged', 2), ('merged', 'full')]
        >>> table[0]["T_90_headroom"]
        1.0

    Raises:
        BadInput: what `marl-clean headroom` refuses, in the same words.
    """
    own: Mapping[str, Any] = {key: value for key, value in keywords.items() if key in OWN}
    others = {key: value for key, value in keywords.items() if key not in OWN}
    texts = [f"{PREFIX}{key}={value_text(key, value)}" for key, value in own.items()]
    listed = [] if settings is None or isinstance(settings, str) else list(settings)
    texts += [text for text in listed if text.startswith(PREFIX)]
    given = [text for text in listed if not text.startswith(PREFIX)] if listed else settings
    plan = make_plan([*overrides_of(given, others), *texts])
    if plan.config.out is None:
        return Headroom(command.measured(plan))
    path = command.path_of(plan)
    check_out(path)
    rows = command.measured(plan)
    command.write_rows(path, rows)
    command.draw(path, rows, plan)
    return Headroom(rows)
