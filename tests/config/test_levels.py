"""Levels as conf/ lists them: what several share stands in one file, and is no level itself."""

import pytest

from marl_clean.config.compose import compose_config, unchecked
from marl_clean.config.levels import SEVERAL, groups, is_target, read_level, rooms
from marl_clean.errors import BadInput
from tests.families import family


def test_what_levels_share_is_no_level() -> None:
    assert not [level for levels in groups().values() for level in levels if level[0] == "_"]
    with pytest.raises(BadInput, match="^agent=_deep_q: no such level; valid: central_dqn"):
        compose_config(["agent=_deep_q"])


ROOMS = {room: rooms()[room] for room in sorted(set(rooms()) - {*SEVERAL, "topology"})}


@family("number", range(max(map(len, ROOMS.values()))), fast=1)
def test_levels_are_read_as_hydra_composes_them(number: int) -> None:
    """One of every room at once, whether they go together or not: composing takes longer."""
    chosen = {room: levels[number % len(levels)] for room, levels in ROOMS.items()}
    composed = unchecked([f"{room}={level}" for room, level in chosen.items()])
    for room, level in chosen.items():
        assert composed[room] == read_level(room, level)


def test_a_target_is_the_class_of_a_level_of_its_room() -> None:
    assert is_target("logger", "marl_clean.logger.csv.Csv")
    for target in ("marl_clean.logger.base.Logger", "marl_clean.comm.plan.Plan", "os.system", ""):
        assert not is_target("logger", target)
