"""Settings as the user gives them, KEY=VALUE: read once, and refused in a line each."""

from collections.abc import Sequence

from marl_clean.config.hydra_adapter import (
    MOST_VALUES,
    Endless,
    NotPlain,
    Override,
    Unoptimised,
    Unreadable,
    parse,
)
from marl_clean.config.levels import PRESETS, SEVERAL, groups
from marl_clean.config.schema import choices
from marl_clean.errors import BadInput

WEIGHTS = "weights"  # of the root; not set by users


def parse_overrides(overrides: Sequence[str], allow_hydra: bool = False) -> list[Override]:
    """The settings, read one by one; a preset is the same with and without its `+`.

    Raises BadInput on a setting that is not KEY=VALUE, adds or deletes a key, or names no level.
    """
    if isinstance(overrides, str):
        raise BadInput(f"{overrides!r} is one text; give a list of settings: [{overrides!r}]")
    parsed = []
    for text in overrides:
        preset = text.startswith(tuple(f"+{group}=" for group in PRESETS))
        try:
            override = parse(text.removeprefix("+") if preset else text)
        except Unreadable:
            raise BadInput(_unreadable(text)) from None
        except Unoptimised:
            raise BadInput(
                f"{text!r}: Hydra cannot read functions where PYTHONOPTIMIZE or -O is set; unset "
                "it, or write the values, such as seed=0,1"
            ) from None
        except Endless:
            valid = f"valid: an end, a step that is not 0, at most {MOST_VALUES} values"
            raise BadInput(f"{text!r}: cannot be listed; {valid}") from None
        except NotPlain:
            reason = "keys are not added, moved or deleted; write KEY=VALUE"
            raise BadInput(f"{text!r}: {reason}") from None
        if override.of_hydra and not allow_hydra:
            raise BadInput(f"{override.key}: Hydra's own settings are for `train -m`")
        if override.key == WEIGHTS:
            raise BadInput(f"{WEIGHTS}: must be left out; `train checkpoint=RUN` fills it in")
        _check_level(override)
        parsed.append(override)
    return parsed


def check_single_values(parsed: Sequence[Override]) -> None:
    """Raises BadInput where a setting has several values, as in a sweep."""
    if sweeping := [override.key for override in parsed if override.is_sweep]:
        raise BadInput(f"{sweeping[0]}: several values are for `train -m` alone; give one")


def _check_level(override: Override) -> None:
    """Raises BadInput when a room is given something that is not one of its levels."""
    levels = groups().get(override.key)
    if levels is None or override.is_sweep:
        return
    value = override.value
    wanted = value if isinstance(value, list) and override.key in SEVERAL else [value]
    if override.key in PRESETS and value is None:
        return
    if len({str(level) for level in wanted}) < len(wanted):
        raise BadInput(f"{override.setting}: names a level twice; once is valid")
    for level in wanted:
        if not isinstance(level, str) or level not in levels:
            raise BadInput(f"{override.setting}: no such level; {choices(str(level), levels)}")


def _unreadable(text: str) -> str:
    """The message for a text that is not a setting, or whose value needs quotes."""
    key, equals, value = text.partition("=")
    if not key.strip() or not equals:
        return f"{text!r} is not a setting; write KEY=VALUE, such as seed=1"
    return f"{key}: cannot read {value!r}; quote special characters: \"{key}='...'\""
