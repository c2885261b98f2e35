"""Settings that stand for several: `house=apartment` is a floor plan where a level is expected."""

from collections.abc import Sequence
from pathlib import Path

from marl_clean.config.levels import groups
from marl_clean.house.floorplan import SHIPPED, SUFFIXES

HOUSE = "house"


def with_floor_plans(settings: Sequence[str]) -> list[str]:
    """Return the settings with `house=PLAN` as `house=floorplan house.path=PLAN`.

    A plan is the name of a shipped plan, or a path that looks like a file; levels stay levels.
    """
    return [part for setting in settings for part in _spelled_out(setting)]


def _spelled_out(setting: str) -> list[str]:
    key, _, text = setting.partition("=")
    if key == HOUSE and _is_floor_plan(text.strip("'\"")):
        return [f"{HOUSE}=floorplan", f"{HOUSE}.path={text}"]
    return [setting]


def _is_floor_plan(value: str) -> bool:
    if value in groups()[HOUSE] or "," in value:  # several values are a sweep
        return False
    shipped = {path.stem for path in SHIPPED.iterdir()}
    return value in shipped or "/" in value or Path(value).suffix.lower() in SUFFIXES
