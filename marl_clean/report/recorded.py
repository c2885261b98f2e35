"""What a `replay.json` holds, and its reading; nothing here needs torch.

Cells are numbered row by row. With T steps and n robots:

| key | value |
|---|---|
| `policy`, `rows`, `cols`, `n_agents`, `max_steps` | whose episode, in which house |
| `house`, `maps` | the codes at step 0, a digit a cell; maps: one for all robots, or one each |
| `house_changes`, `map_changes` | T lists `[cell, code, cell, code, ...]`; one for each map |
| `positions` | T + 1 lists `[row, col, row, col, ...]`, a place for each robot |
| `coverage` | T + 1 shares of the house's free cells that have been cleaned |
| `contacts` | T lists `[i, j, i, j, ...]`, i < j: who could hear whom when actions were chosen |
| `bits` | T lists of what each robot's message cost; missing where policies send none |
| `messages` | bytes in base64, `[T, n, message_numbers]`: 128 is 0, 1 and 255 are `largest` |
"""

import base64
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from marl_clean.errors import BadInput
from marl_clean.storage.reading import parse_json, read_bytes

SCHEMA = 1
REPLAY = "replay.json"
WALL, FURNITURE, DIRTY, CLEAN, SPILT = range(5)  # what a cell of the house is
UNKNOWN, BLOCKED, AVAILABLE = range(3)  # what a map holds; from AVAILABLE on the cleaner the higher
LEVELS = 5  # of how clean an available cell is, from dirty to just cleaned
MOST_BYTES, MOST_VALUES = 64 << 20, 8_000_000

Recording = dict[str, Any]


class _Recording(BaseModel, strict=True, extra="forbid"):
    """The format, checked so far that a player of it cannot fail."""

    schema_: int = Field(alias="schema")
    policy: str
    rows: int = Field(ge=1)
    cols: int = Field(ge=1)
    n_agents: int = Field(ge=1)
    max_steps: int
    house: str
    maps: list[str] = Field(min_length=1)
    house_changes: list[list[int]]
    map_changes: list[list[list[int]]]
    positions: list[list[int]]
    coverage: list[FiniteFloat]
    contacts: list[list[int]]
    bits: list[list[FiniteFloat]] | None = None
    messages: str | None = None
    message_numbers: int | None = None
    largest: FiniteFloat | None = None

    @model_validator(mode="after")
    def _fits(self) -> "_Recording":
        steps, cells, robots = len(self.contacts), self.rows * self.cols, self.n_agents
        highest = {"house": SPILT, "maps": AVAILABLE + LEVELS}
        matrices = [("house", self.house), *(("maps", held) for held in self.maps)]
        for name, digits in matrices:
            _require(len(digits) == cells, f"{name}: {rows_by_cols(self)} need {cells} digits")
            _require(digits.isdecimal() and digits.isascii(), f"{name}: digits are valid")
            _require(int(max(digits)) <= highest[name], f"{name}: codes up to {highest[name]}")
        _require(len(self.maps) in (1, robots), f"maps: 1 or {robots} are valid")
        for name, length in (
            ("house_changes", steps),
            ("map_changes", steps),
            ("positions", steps + 1),
            ("coverage", steps + 1),
            *((("bits", steps),) if self.bits is not None else ()),
        ):
            _require(len(getattr(self, name)) == length, f"{name}: {length} are needed")
        for changed in self.house_changes:
            _require_changes("house_changes", changed, cells, SPILT)
        for maps in self.map_changes:
            _require(len(maps) == len(self.maps), "map_changes: a list for each map is needed")
            for changed in maps:
                _require_changes("map_changes", changed, cells, AVAILABLE + LEVELS)
        for places in self.positions:
            inside = all(0 <= row < self.rows for row in places[::2]) and all(
                0 <= col < self.cols for col in places[1::2]
            )
            _require(len(places) == 2 * robots and inside, "positions: a cell for each robot")
        for ends in self.contacts:
            known = all(0 <= robot < robots for robot in ends)
            _require(len(ends) % 2 == 0 and known, f"contacts: pairs of robots below {robots}")
        for costs in self.bits or ():
            _require(len(costs) == robots, "bits: a number for each robot")
        if self.messages is not None:
            _require(
                self.message_numbers is not None and self.largest is not None,
                "messages: message_numbers and largest are needed",
            )
            length = steps * robots * (self.message_numbers or 0)
            held = base64.b64decode(self.messages, validate=True)
            _require(len(held) == length, f"messages: {length} bytes are needed")
        return self


def rows_by_cols(recording: _Recording) -> str:
    return f"{recording.rows} x {recording.cols} cells"


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise ValueError(fault)


def _require_changes(name: str, changed: list[int], cells: int, highest: int) -> None:
    cell_ids, codes = changed[::2], changed[1::2]
    fits = all(0 <= cell < cells for cell in cell_ids) and all(0 <= c <= highest for c in codes)
    _require(len(changed) % 2 == 0 and fits, f"{name}: pairs of a cell and its code")


def read_recording(path: Path) -> Recording:
    """Return a recording, which need not be trusted.

    Raises BadInput where it cannot be read, is larger than 64 MiB, or is no recording.
    """
    content = read_bytes(path, MOST_BYTES)
    try:
        recording = parse_json(content, MOST_VALUES)
    except ValueError as error:
        raise BadInput(f"{path}: is not JSON ({error}); a {REPLAY} is valid") from error
    if not isinstance(recording, dict) or recording.get("schema") != SCHEMA:
        raise BadInput(f"{path}: is no recording of schema {SCHEMA}")
    try:
        _Recording.model_validate(recording)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))[:80]
        fault = first["msg"].removeprefix("Value error, ")
        raise BadInput(f"{path}: {place + ': ' if place else ''}{fault}") from error
    return recording
