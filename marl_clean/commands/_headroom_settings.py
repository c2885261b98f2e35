"""Settings of `marl-clean headroom` itself, `headroom.KEY=VALUE`, and the plays they ask for."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, get_type_hints

from omegaconf import DictConfig, OmegaConf
from pydantic import Field

from marl_clean.commands.checks import check_all, check_shows_houses
from marl_clean.config.compose import PERFECT, compose_parsed
from marl_clean.config.hydra_adapter import Override
from marl_clean.config.levels import level_of, read_level
from marl_clean.config.overrides import check_single_values, parse_overrides
from marl_clean.config.schema import convert, problems_of_mapping
from marl_clean.errors import BadInput
from marl_clean.evaluation.headroom import FULL, Cell
from marl_clean.settings import Assignment, HouseSide, Memory, PositiveInt, Probability

PREFIX = "headroom."
SIDES = (8, 10, 14, 17, 20)
REACHING = ("view", "radius", "sight")
CARRIES_MAPS = ("perfect", "lossy", "budget")
"""Channels that decide which edges a message crosses; others change numbers, and a map has none."""
VARIED = {
    "env.n_agents": "robots",
    "env.memory": None,
    "planner.assignment": None,
    "evaluation.houses": "houses",
    "house.rows": "sides",
    "house.cols": "sides",
}
"""Keys that the grid sets, and the setting that it sets each by; None: it plays all values."""
Team = Annotated[int, Field(ge=2, le=64)]
Reach = Annotated[int, Field(ge=1, le=64)] | Literal["full"]  # as far as a radius may be


@dataclass(frozen=True)
class HeadroomSettings:
    """The grid of cells.

    Attributes:
        sides: of square houses in cells; None: 8, 10, 14, 17, 20 where the room makes houses of
            any size, else the room's own houses.
        robots: numbers of robots.
        reaches: up to how many cells robots are in contact, or full; half of the side of a view.
        losses: shares of maps that are lost on their way; None: the channel of the config.
        houses: held-out houses in each cell; of a plan starts.
    """

    sides: list[HouseSide] | None = None
    robots: Annotated[list[Team], Field(min_length=1)] = (2, 4, 8)  # type: ignore[assignment]
    reaches: Annotated[list[Reach], Field(min_length=1)] = (3, 5, 7, FULL)  # type: ignore[assignment]
    losses: Annotated[list[Probability], Field(min_length=1)] | None = None
    houses: PositiveInt = 40


@dataclass(frozen=True)
class Play:
    """One play: a cell, what the robots know, and the config that says so."""

    cell: Cell
    memory: Memory
    assignment: Assignment
    config: DictConfig

    @property
    def label(self) -> str:
        """What is played, for the progress."""
        cell = self.cell
        parts = [cell.place, f"{cell.n_agents} robots", f"{self.memory} maps"]
        if cell.reach is not None:
            parts += [f"reach {cell.reach}", str(cell.channel)]
        return ", ".join([*parts, f"assignment {self.assignment}"])


@dataclass(frozen=True)
class Plan:
    """A grid, all of whose input has been checked."""

    settings: HeadroomSettings
    config: DictConfig
    plays: list[Play]


def described() -> str:
    """Every setting with its default, for the help."""
    return ", ".join(f"{PREFIX}{f.name}={_text(f.default)}" for f in fields(HeadroomSettings))


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{','.join(map(str, value))}]"
    return "null" if value is None else str(value)


def make_plan(texts: Sequence[str]) -> Plan:
    """The plays that a command's settings ask for, in order. Raises BadInput before any begins."""
    settings = _read_settings([text for text in texts if text.startswith(PREFIX)])
    parsed = parse_overrides([text for text in texts if not text.startswith(PREFIX)])
    _refuse_varied(parsed)
    config = compose_parsed(parsed)
    check_shows_houses(config)
    if config.checkpoint is not None:
        raise BadInput(f"checkpoint={config.checkpoint}: headroom plays planners; leave it out")
    if config.out is not None and not config.out.endswith(".json"):
        raise BadInput(f"out={config.out}: must end with .json; the csv and figures go beside it")
    planner = level_of(config.planner._target_)
    if "assignment" not in config.planner:
        raise BadInput(f"planner={planner}: has no targets to assign; valid: nearest_unknown")
    topology = level_of(config.topology._target_)
    if topology not in REACHING:
        valid = ", ".join(REACHING)
        raise BadInput(f"topology={topology}: {PREFIX}reaches sets how far it is; valid: {valid}")
    check_all(config)
    plays = list(_plays(settings, config))
    checked: set[tuple[str, int]] = set()
    for play in plays:
        houses = play.cell.place, play.cell.n_agents
        if houses in checked:
            continue
        checked.add(houses)
        try:
            check_all(play.config)
        except BadInput as error:
            raise BadInput(f"headroom: {houses[0]}, {houses[1]} robots: {error}") from None
    return Plan(settings, config, plays)


def _read_settings(texts: Sequence[str]) -> HeadroomSettings:
    """The settings in texts `headroom.KEY=VALUE`. Raises BadInput where one is wrong."""
    parsed = parse_overrides(texts)
    check_single_values(parsed)
    types = get_type_hints(HeadroomSettings, include_extras=True)
    values = {override.key.removeprefix(PREFIX): override.value for override in parsed}
    for problem in problems_of_mapping(values, types, PREFIX, ()):
        raise BadInput(f"{problem.key}: {problem.reason}")
    for name, value in values.items():
        for item in value if isinstance(value, list) else ():
            if value.count(item) > 1:
                raise BadInput(f"{PREFIX}{name}: {item} stands there twice; once is valid")
    return HeadroomSettings(**{name: convert(value, types[name]) for name, value in values.items()})


def _refuse_varied(parsed: Sequence[Override]) -> None:
    """Raises BadInput for a setting that the grid itself varies."""
    for override in parsed:
        if override.key in VARIED:
            own = VARIED[override.key]
            remedy = "leave it out" if own is None else f"give {PREFIX}{own}"
            raise BadInput(f"{override.key}: headroom plays all that it compares; {remedy}")


def _plays(settings: HeadroomSettings, config: DictConfig) -> Iterator[Play]:
    """Every play, those of a cell after those of private and shared maps that it needs."""
    channels = _channels(settings, config)
    for place, placed in _places(settings, config):
        for n_agents in settings.robots:
            without = Cell(place, n_agents)
            cells: list[tuple[Cell, Memory, DictConfig | None]]
            cells = [(without, Memory.PRIVATE, None), (without, Memory.SHARED, None)]
            cells += [
                (Cell(place, n_agents, reach, name), Memory.MERGED, channel)
                for name, channel in channels.items()
                for reach in settings.reaches
            ]
            for cell, memory, channel in cells:
                for assignment in Assignment:
                    played = _config_of(placed, cell, memory, assignment, channel)
                    yield Play(cell, memory, assignment, played)


def _places(settings: HeadroomSettings, config: DictConfig) -> Iterator[tuple[str, DictConfig]]:
    """The houses, by name. Raises BadInput for sides of houses that have their own."""
    placed = config.copy()
    placed.evaluation.houses = settings.houses
    level = level_of(config.house._target_)
    if "rows" not in config.house or "cols" not in config.house:
        if settings.sides is not None:
            raise BadInput(f"{PREFIX}sides: houses of house={level} have their own; leave it out")
        yield str(config.house.get("path") or level), placed
        return
    for side in settings.sides if settings.sides is not None else SIDES:
        sized = placed.copy()
        sized.house.rows = sized.house.cols = [side, side]
        yield f"{side}x{side}", sized


def _channels(settings: HeadroomSettings, config: DictConfig) -> dict[str, DictConfig]:
    """The channels by name. Raises BadInput where one does more to messages than to lose some."""
    if settings.losses is None:
        _check_channel(config.channel)
        return {"+".join(map(str, config.channel)): config.channel}
    if list(config.channel) != list(PERFECT):
        name = "+".join(map(str, config.channel))
        raise BadInput(f"{PREFIX}losses: channel={name} says what is lost; give one of them")
    lossy = read_level("channel", "lossy")
    return {
        f"loss {loss:g}" if loss else "perfect": OmegaConf.create(
            {"lossy": {**lossy, "loss": loss}} if loss else PERFECT
        )
        for loss in settings.losses
    }


def _check_channel(channel: DictConfig) -> None:
    for section in channel.values():
        level = level_of(section["_target_"])
        if level not in CARRIES_MAPS:
            valid = ", ".join(CARRIES_MAPS)
            raise BadInput(
                f"channel={level}: headroom sends maps, which it cannot carry; valid: {valid}"
            )
        if level == "lossy" and section["burst_start"] > 0:
            raise BadInput(
                f"channel.lossy.burst_start={section['burst_start']}: headroom keeps no state of"
                " channels between steps; valid: 0"
            )


def _config_of(
    config: DictConfig,
    cell: Cell,
    memory: Memory,
    assignment: Assignment,
    channel: DictConfig | None,
) -> DictConfig:
    """The config of one play.

    A `view` reaches as far as half of its side, a `radius` or `sight` as far as it says.
    """
    planned = config.copy()
    planned.env.n_agents, planned.env.memory = cell.n_agents, memory.value
    planned.planner.assignment = assignment.value
    planned.env.compile = False  # takes longer than to play
    planned.channel = OmegaConf.create(PERFECT) if channel is None else channel
    if cell.reach == FULL:
        planned.topology = OmegaConf.create(read_level("topology", FULL))
    elif cell.reach is not None and "radius_cells" in planned.topology:
        planned.topology.radius_cells = float(cell.reach)
    elif cell.reach is not None:
        planned.topology.view_size = 2 * int(cell.reach) + 1
    planned.comm = OmegaConf.create(read_level("comm", "none"))  # `delta` would unite private maps
    # What is observed, which planners do not see: the least, since maps have its margin.
    planned.observation = {**read_level("observation", "crop"), "view_size": 1}
    return planned
