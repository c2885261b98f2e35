"""What a preset sets, read without composing a config.

Hydra composes presets with the defaults of `conf/`. On top of an earlier run's config, which has
no defaults, a preset must change what it names and nothing else.
"""

from pathlib import Path
from typing import Any

from marl_clean.errors import BadInput
from marl_clean.storage.safe_yaml import load_yaml

OVERRIDE = "override /"
STUDY = "study"  # a preset's section that is no setting of a run


def read_preset(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The level of each room that a preset's yaml chooses, and the values it sets, in their order.

    Presets that it builds on come first, as in Hydra; they lie in the same folder.
    """
    values = load_yaml(path)
    values.pop("hydra", None)  # how it is swept
    values.pop(STUDY, None)
    levels: dict[str, Any] = {}
    sets: list[dict[str, Any]] = []
    for entry in values.pop("defaults", []):
        if isinstance(entry, str):
            chosen, set_before = read_preset(path.with_name(f"{entry}.yaml"))
            levels |= chosen
            sets += set_before
        else:
            levels |= {key.removeprefix(OVERRIDE): level for key, level in entry.items()}
    return levels, [*sets, values]


def sweep_of(path: Path) -> dict[str, str]:
    """The values that a preset sweeps its keys over: its `hydra.sweeper.params`, as texts.

    Sweeps of presets that it builds on are included, unless it overrides them.
    """
    values = load_yaml(path)
    swept: dict[str, str] = {}
    for entry in values.get("defaults", []):
        if isinstance(entry, str):
            swept |= sweep_of(path.with_name(f"{entry}.yaml"))
    own = values.get("hydra", {}).get("sweeper", {}).get("params", {})
    return swept | {key: str(value) for key, value in own.items()}


def study_of(path: Path) -> dict[str, Any] | None:
    """A preset's section `study` as it stands, over those of presets that it builds on, or None."""
    values = load_yaml(path)
    sections = [
        study_of(path.with_name(f"{entry}.yaml"))
        for entry in values.get("defaults", [])
        if isinstance(entry, str) and entry != "_self_"
    ]
    sections.append(values.get(STUDY))
    given = [section for section in sections if section is not None]
    if not given:
        return None
    if not all(isinstance(section, dict) for section in given):
        raise BadInput(f"{path}: {STUDY}: must be a section with arms, seeds, measure and rules")
    return {key: value for section in given for key, value in section.items()}
