"""`tidy.csv`: a comparison as tidy data, one line for each policy, seed and house.

| column | is |
|---|---|
| `world` | a hash of rules, houses and starts; lines that share it are comparable |
| `setting` | a hash of the config without its seed; empty for a planner |
| `row` | the label of the setting in the comparison, or the planner's name |
| `silent` | 1 for a setting without communication |
| `parameters` | of the network; may be empty |
| `policy`, `seed` | the run's name and seed; no seed for a planner |
| `house_set`, `n_agents`, `epsilon`, `config_hash`, `schema`, `rules` | as in evaluation.json, where `rules` is `world`, the version of the rules |
| `house`, `houses` | the place of the house in its set, from 0, and the size of the set |
| all others | a measure (`T_100`) or a property of the house (`rows`, `max_steps`; its seed is `house_seed`) |

`NA` is null, as for a time not reached; an empty cell was not measured. pandas and R read both as missing.
"""  # noqa: E501

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from marl_clean.errors import BadInput
from marl_clean.evaluation.measured import (
    MOST_VALUES,
    Measured,
    check_exported,
    entry_of,
    read_text,
    versions_fit,
)

NAME = "tidy.csv"
ABOUT = ("world", "setting", "row", "silent", "parameters", "policy", "seed")
ENTRY = ("house_set", "n_agents", "epsilon", "config_hash", "schema", "rules")
FIXED = (*ABOUT, *ENTRY, "house", "houses")
OF_HOUSE = "house_"  # before a property of a house whose name is a column of another meaning
TEXTS = ("path",)  # properties of a house that are no number
NULL = "NA"
WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,18})")
DECIMAL = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?")


def to_tidy(measured: Sequence[Measured]) -> str:
    """The text of tidy.csv."""
    names = dict.fromkeys(
        name for item in measured for house in item.entry["houses"] for name in house
    )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*FIXED, *map(_column, names)])
    for item in measured:
        entry = item.entry
        about = [item.world, item.setting, item.label, int(item.silent), item.parameters]
        about += [entry["policy"], item.seed, entry["house_set"], entry["n_agents"]]
        about += [repr(entry["epsilon"]), entry["config_hash"], entry["schema"], entry["world"]]
        size = len(entry["houses"])
        for place, house in enumerate(entry["houses"]):
            cells = [_cell(house[name]) if name in house else "" for name in names]
            writer.writerow([*about, place, size, *cells])
    return text.getvalue()


def _cell(value: float | int | str | None) -> str:
    if value is None:
        return NULL
    return value if isinstance(value, str) else repr(value)


def _column(name: str) -> str:
    """The column of a property of houses; another than that of what is said of the whole entry."""
    return f"{OF_HOUSE}{name}" if name in FIXED or name.startswith(OF_HOUSE) else name


def _property(column: str) -> str:
    """The property of houses that stands in a column."""
    return column.removeprefix(OF_HOUSE)


def read_tidy(path: Path) -> list[Measured]:
    """What a tidy.csv holds; entries of another version are logged and left out.

    Raises BadInput where the file is none, or only the beginning of one.
    """
    text = read_text(path)
    if text.count(",") > MOST_VALUES:
        raise BadInput(f"{path}: holds more than {MOST_VALUES:,} values; not an export")
    lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        columns = next(lines)
        names = [_property(column) for column in columns[len(FIXED) :]]
        if tuple(columns[: len(FIXED)]) != FIXED or len({*names}) < len(names) or not names:
            raise BadInput(f"{path}: has other columns than {NAME} of `compare --export`")
        groups = _groups(path, lines, names)
    except csv.Error as error:
        raise BadInput(
            f"{path}: line {lines.line_num}: {error}; half-written, or no csv"
        ) from error
    result = []
    for about, houses in groups.items():
        fields = dict(zip((*ABOUT, *ENTRY, "houses"), about, strict=True))
        try:
            versions = [_number(fields[name]) for name in ("schema", "rules")]
        except ValueError as error:
            raise BadInput(f"{path}: {fields['policy'][:80]}: {error}; not of an export") from error
        if versions_fit(path, fields["policy"], *versions):
            result.append(_measured(path, fields, houses))
    check_exported(path, result)
    return result


def _groups(
    path: Path, lines: Any, names: Sequence[str]
) -> dict[tuple[str, ...], dict[str, dict[str, Any]]]:
    """The values of each entry, by house and measure; entries by what is said about them."""
    groups: dict[tuple[str, ...], dict[str, dict[str, Any]]] = {}
    for line in lines:
        if len(line) != len(FIXED) + len(names):
            reason = f"not {len(FIXED) + len(names)} cells; half-written"
            raise BadInput(f"{path}: line {lines.line_num}: {reason}")
        about, (house, size) = line[: len(FIXED) - 2], line[len(FIXED) - 2 : len(FIXED)]
        houses = groups.setdefault((*about, size), {})
        if house in houses:
            raise BadInput(f"{path}: line {lines.line_num}: this house of the run stands twice")
        houses[house] = values = {}
        for name, text in zip(names, line[len(FIXED) :], strict=True):
            if not text:
                continue
            try:
                values[name] = text if name in TEXTS and text != NULL else _value(text)
            except ValueError:
                reason = f"{path}: line {lines.line_num}: {name}: {text[:40]!r} is no number"
                raise BadInput(reason) from None
    return groups


def _value(text: str) -> int | float | None:
    return None if text == NULL else _number(text)


def _measured(path: Path, fields: dict[str, str], houses: dict[str, dict[str, Any]]) -> Measured:
    if list(houses) != [str(place) for place in range(len(houses))] or fields["houses"] != str(
        len(houses)
    ):
        raise BadInput(
            f"{path}: {fields['policy'][:80]}: {len(houses)} of {fields['houses'][:20]} houses;"
            " half-written"
        )
    try:
        entry = {
            "schema": _whole(fields["schema"]),
            "world": _number(fields["rules"]),
            "policy": fields["policy"],
            "house_set": fields["house_set"],
            "config_hash": fields["config_hash"],
            "epsilon": _number(fields["epsilon"]),
            "n_agents": _whole(fields["n_agents"]),
        }
        seed, parameters = (
            _whole(fields[name]) if fields[name] else None for name in ("seed", "parameters")
        )
        silent = _whole(fields["silent"])
    except ValueError as error:
        raise BadInput(f"{path}: {fields['policy'][:80]}: {error}; not of an export") from error
    return Measured(
        fields["world"],
        fields["setting"] or None,
        seed,
        entry_of(path, entry, list(houses.values())),
        fields["row"],
        bool(silent),
        parameters,
    )


def _number(text: str) -> int | float | None:
    """A number as Python writes it; None for an empty text. Raises ValueError for any other."""
    if not text:
        return None
    if WHOLE.fullmatch(text):
        return int(text)
    if not DECIMAL.fullmatch(text) or not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:40]!r} is no number")
    return value


def _whole(text: str) -> int:
    """A whole number. Raises ValueError for any other text."""
    value = _number(text)
    if not isinstance(value, int):
        raise ValueError(f"{text[:40]!r} is no whole number")
    return value
