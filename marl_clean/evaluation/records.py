"""`evaluation.json`: measures house by house, and their summaries.

A list with one entry for each (policy, set of houses); `schema` is the version of this format,
`world` that of the rules. Nothing here needs torch.
"""

import json
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, BaseModel, Field, TypeAdapter, ValidationError

from marl_clean.errors import BadInput
from marl_clean.evaluation.aggregates import iqm
from marl_clean.evaluation.resampling import interval
from marl_clean.evaluation.statistics import as_sample, estimate
from marl_clean.storage import files
from marl_clean.storage.reading import parse_json, read_bytes

SCHEMA = 1
MEASURED = "evaluation.json"
WORLD = 0
LARGEST = 1e50  # of a measure, and far from where its square is infinite
LARGEST_BYTES = 64 << 20  # of such a file: 10,000 houses with ours and three planners

House = Mapping[str, Any]  # one house's record
Entry = dict[str, Any]  # one policy on one set of houses

TIMES = ("90", "95", "99", "100", "certify")
MEASURES = (
    *(f"T_{name}" for name in TIMES),
    *(f"ratio_{name}" for name in TIMES),
    *("coverage", "coverage_auc", "return", "redundancy", "overlap", "balance"),
    *("bumps", "collisions", "contact", "messages", "edges", "bits", "rounds"),
    *("messages_per_cell", "edges_per_cell", "bits_per_cell", "rounds_per_cell", "gate"),
    *("optimum_100", "gap_100", "spill_delay", "spill_cleaned"),
)
SHOWN = ("T_90", "T_100", "coverage", "redundancy")  # in every table of houses
SHOWN_EXTERNAL = ("return",)  # in tables of external tasks, which have no cells


def printable(text: str) -> str:
    """The text. Raises ValueError where a terminal would not show all of it."""
    if not text.isprintable():
        raise ValueError("printable characters are valid")
    return text


Printable = Annotated[str, AfterValidator(printable)]
Number = Annotated[float, Field(gt=-LARGEST, lt=LARGEST)]


class _ReadSummary(BaseModel, strict=True):
    """The fields of a measure's summary that readers need."""

    mean: Number | None
    ci95: Annotated[list[Number], Field(min_length=2, max_length=2)] | None
    reached: Number


class _ReadEntry(BaseModel, strict=True):
    """The fields of an entry that readers need."""

    policy: Printable
    house_set: Printable
    epsilon: Number
    n_agents: int
    houses: Annotated[list[dict[str, Number | str | None]], Field(min_length=1)]
    summary: dict[str, _ReadSummary]
    runs: Literal[1] = 1  # several are pooled in memory alone


def make_entry(
    policy: str,
    house_set: str,
    config_hash: str,
    epsilon: float,
    n_agents: int,
    houses: Sequence[House],
) -> Entry:
    """One entry of evaluation.json, its summary computed."""
    return {
        "schema": SCHEMA,
        "world": WORLD,
        "policy": policy,
        "house_set": house_set,
        "config_hash": config_hash,
        "epsilon": epsilon,
        "n_agents": n_agents,
        "houses": [dict(house) for house in houses],
        "summary": summarise([houses]),
    }


def summarise(
    runs: Sequence[Sequence[House]], measures: Sequence[str] = MEASURES
) -> dict[str, dict[str, Any]]:
    """Mean and interquartile mean of each measure with intervals, and the share with a value.

    `runs` are one policy's records over the same houses, once for each training seed. A time
    that was not reached counts as the house's `max_steps` in mean, iqm and interval; `reached`
    is the share of houses that reached it. A measure without any value has nulls.
    """
    summary = {}
    for measure in measures:
        if any(measure not in run[0] for run in runs):
            continue  # measured on demand, or newer than the file
        values = sample(runs, measure)
        estimated, middle = estimate(values), interval(values, iqm)
        summary[measure] = {
            "mean": estimated.mean,
            "ci95": None if estimated.ci95 is None else list(estimated.ci95),
            "iqm": middle.value,
            "iqm_ci95": None if middle.ci95 is None else list(middle.ci95),
            "reached": share_reached(runs, measure),
        }
    return summary


def means(houses: Sequence[House]) -> dict[str, float]:
    """The means of every measure that has a value, and the share of houses `finished`."""
    result = {"finished": share_reached([houses], "T_100")}
    for measure in MEASURES:
        values = sample([houses], measure) if measure in houses[0] else np.array([np.nan])
        if np.isfinite(values).any():
            result[measure] = float(np.nanmean(values))
    return result


def sample(runs: Sequence[Sequence[House]], measure: str) -> Float[np.ndarray, "run house"]:
    """A measure's values as they enter means; NaN for missing values, as for a bound of 0."""
    return as_sample([[counted(house, measure) for house in run] for run in runs])


def runs_of(entry: Entry) -> list[list[House]]:
    """The records of each run of an entry, which has several where seeds are pooled (`runs`)."""
    houses, runs = entry["houses"], entry.get("runs", 1)
    size = len(houses) // runs
    return [houses[run * size : (run + 1) * size] for run in range(runs)]


def share_reached(runs: Sequence[Sequence[House]], measure: str) -> float:
    """The share of houses in which a measure is not null."""
    return float(np.mean([house[measure] is not None for run in runs for house in run]))


def counted(house: House, measure: str) -> int | float | None:
    """One house's value as it enters means: a time that was not reached is `max_steps`."""
    kind, _, name = measure.partition("_")
    if house[measure] is not None or kind not in ("T", "ratio", "gap"):
        return house[measure]
    if kind == "T":
        return house["max_steps"]
    least = house[f"optimum_{name}" if kind == "gap" else f"bound_{name}"]
    return house["max_steps"] / least if least else None


def write_entries(path: Path, entries: Sequence[Entry]) -> None:
    """Write evaluation.json whole or not at all. Raises BadInput where it cannot be written."""
    text = json.dumps(list(entries), indent=1, allow_nan=False) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_file(path, [text.encode()])
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from error


class Torn(BadInput):
    """A file that is there and is not whole: not what this version or any other wrote."""


def read_entries(path: Path) -> list[Entry]:
    """The entries of an evaluation.json, which need not be trusted.

    Raises Torn when it is not an evaluation.json or lacks what tables and comparisons need, and
    another BadInput when it cannot be read or has another version.
    """
    content = read_bytes(path, LARGEST_BYTES)
    try:
        entries = parse_json(content)
    except ValueError as error:
        raise Torn(f"{path}: is not JSON ({error}); an evaluation.json is valid") from error
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise Torn(f"{path}: is not a list of entries; an evaluation.json is valid")
    for number, entry in enumerate(entries):
        if entry.get("schema") != SCHEMA:
            schema = reprlib.repr(entry.get("schema"))
            raise BadInput(f"{path}: schema {schema}, only {SCHEMA} is valid")
        if entry.get("world") not in (WORLD, None):  # an external task has no version
            world = reprlib.repr(entry["world"])
            raise BadInput(f"{path}: world version {world}, only {WORLD} is valid")
        if (fault := entry_fault(entry)) is not None:
            raise Torn(f"{path}: entry {number}: {fault}; an evaluation.json is valid")
    return entries


def entry_fault(entry: Entry) -> str | None:
    """The reason why an entry cannot be shown and pooled with others; None if it can."""
    try:
        TypeAdapter(_ReadEntry).validate_python(entry)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        return f"{'.'.join(map(str, first['loc']))[:80]}: {first['msg']}"
    if (fault := house_fault(entry["houses"])) is not None:
        return fault
    shown = SHOWN if "T_100" in entry["houses"][0] else SHOWN_EXTERNAL
    for name in shown:
        if name not in entry["summary"] or None in (
            entry["summary"][name]["mean"],
            entry["summary"][name]["ci95"],
        ):
            return f"summary.{name}: is missing"
    return None


def house_fault(houses: Sequence[House]) -> str | None:
    """The reason why records cannot be summarised and pooled with others; None if they can."""
    cells = {"T_100", "max_steps"} & set(houses[0])  # external tasks have neither
    shown = SHOWN if cells else SHOWN_EXTERNAL
    measured = {name for name in MEASURES if name in houses[0]} | {*shown}
    needed = measured | {least for name in measured for least in _fallback_keys(name)}
    for house in houses:
        if not needed <= house.keys():
            return f"a house has no {min(needed - house.keys())}"
        if not all(map(_is_number, (house[name] for name in needed))):
            others = (name for name in needed if not _is_number(house[name]))
            return f"a house has no number {min(others)}"
        if house.get("max_steps", 0) is None:
            return "a house has no number max_steps"
    return None


def _is_number(value: Any) -> bool:
    """Whether a record may hold it as a measure: a number that statistics can square, or null."""
    return value is None or (type(value) in (int, float) and abs(value) < LARGEST)


def _fallback_keys(measure: str) -> tuple[str, ...]:
    """The keys of a house that `counted` needs where a measure is null."""
    kind, _, name = measure.partition("_")
    return {
        "T": ("max_steps",),
        "ratio": ("max_steps", f"bound_{name}"),
        "gap": ("max_steps", f"optimum_{name}"),
    }.get(kind, ())
