"""From `key=value` settings to one checked config, before torch is imported.

Hydra composes the defaults of `conf/` with the settings, `schema` holds the result against the
constructors' signatures, and what is wrong becomes one line.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_type_hints

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from hydra.initialize import get_gh_backup, restore_gh_from_backup
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from marl_clean.config import class_source, schema
from marl_clean.config.config_hash import config_hash, container
from marl_clean.config.locate import own
from marl_clean.config.presets import read_preset
from marl_clean.errors import BadInput
from marl_clean.settings import Evaluation, Root

EXPERIMENT = "experiment"
BUDGET = "budget"
PRESETS = (EXPERIMENT, BUDGET)  # groups that set keys of several rooms, and are none themselves
SEVERAL = ("logger", "channel")  # rooms of which several levels may be taken at once, by name
PERFECT = {"perfect": {"_target_": "marl_clean.channel.perfect.Perfect"}}
WEIGHTS = "weights"  # of the root; not the user's to set


def conf_folder() -> Path:
    """The folder of this package's yaml files."""
    return own().conf


def rooms() -> dict[str, list[str]]:
    """The rooms of `conf/` and the levels of each; presets are not rooms."""
    return {room: levels for room, levels in groups().items() if room not in PRESETS}


def compose_config(overrides: Sequence[str] = ()) -> DictConfig:
    """The config that `overrides` describe, checked and resolved.

    Raises BadInput on what cannot be read, is unknown, or has a wrong type or value.
    """
    parsed = parse_overrides(overrides)
    one_value_each(parsed)
    return checked(resolved(_composed(parsed)), parsed)


def plays_houses(config: DictConfig) -> bool:
    """Whether the config's env is played in houses, or is a task of others that has none."""
    return class_source.takes(config.env._target_, "houses")


def parse_overrides(overrides: Sequence[str], hydra_too: bool = False) -> list[Override]:
    """The settings, read one by one; with and without the `+` a preset is the same.

    Raises BadInput on one that is no KEY=VALUE, adds or deletes a key, or names no level.
    """
    parser = OverridesParser.create()
    parsed = []
    for text in overrides:
        preset = text.startswith(tuple(f"+{group}=" for group in PRESETS))
        setting = text.removeprefix("+") if preset else text
        try:
            [override] = parser.parse_overrides([setting])
        except HydraException:
            raise BadInput(_unreadable(text)) from None
        if override.is_hydra_override() and not hydra_too:
            raise BadInput(f"{override.key_or_group}: Hydra's own settings are for `train -m`")
        if not override.key_or_group:
            raise BadInput(_unreadable(text))
        if override.type is not OverrideType.CHANGE or override.package is not None:
            raise BadInput(f"{text!r}: keys are not added, moved or deleted; write KEY=VALUE")
        if override.key_or_group == WEIGHTS:
            raise BadInput(f"{WEIGHTS}: must be left out; `train checkpoint=RUN` fills it in")
        _check_level(override)
        parsed.append(override)
    return parsed


def apply(config: dict[str, Any], parsed: Sequence[Override]) -> dict[str, Any]:
    """`config` of an earlier run, with presets, then overridden levels and values on top."""
    one_value_each(parsed)
    levels: dict[str, Any] = {}
    sets: list[dict[str, Any]] = []
    for group in PRESETS:
        for name in [o.value() for o in parsed if o.key_or_group == group][-1:]:
            if name is not None:
                chosen, values = read_preset(conf_folder() / group / f"{name}.yaml")
                levels |= chosen
                sets += values
    levels |= {o.key_or_group: o.value() for o in parsed if o.key_or_group in rooms()}
    composed = container(_composed(parse_overrides([f"{k}={v}" for k, v in levels.items()])))
    chosen_levels = {room: composed[room] for room in levels}
    merged = OmegaConf.create(config | chosen_levels)
    merged.merge_with(*sets)
    known = container(merged)
    for override in parsed:
        key = override.key_or_group
        if key in groups():
            continue
        if key not in set(_keys(known)):
            raise BadInput(_unknown(key, known))
        OmegaConf.update(merged, key, override.value(), merge=True)
    return resolved(merged)


def one_value_each(parsed: Sequence[Override]) -> None:
    """Raises BadInput where a setting has several values, as a sweep's have."""
    if sweeping := [o.key_or_group for o in parsed if o.is_sweep_override()]:
        raise BadInput(f"{sweeping[0]}: several values are for `train -m` alone; give one")


def resolved(config: DictConfig) -> dict[str, Any]:
    """The config as plain data, every `${...}` replaced. Raises BadInput on one that cannot be."""
    try:
        plain = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise BadInput(f"{error.full_key}: {_first_line(error)}") from None
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def checked(plain: dict[str, Any], parsed: Sequence[Override] = ()) -> DictConfig:
    """`plain` as a config with its `name` filled in. Raises BadInput when the schema says no."""
    plain = {**plain, "logger": plain.get("logger") or {}}  # none at all is a choice, too
    plain["channel"] = plain.get("channel") or PERFECT
    problems = list(_problems(plain))
    if problems:
        asked = {override.key_or_group for override in parsed}
        first = next((p for p in problems if p.key in asked), problems[0])
        raise BadInput(f"{first.key}: {first.reason}")
    config = OmegaConf.create(plain)
    if config.name is None:
        presets = [o.value() for o in parsed if o.key_or_group == EXPERIMENT]
        config.name = f"{(presets and presets[-1]) or 'run'}-{config_hash(config)[:8]}"
    OmegaConf.set_struct(config, True)
    return config


def _problems(plain: Mapping[str, Any]) -> Iterator[schema.Problem]:
    """Everything in the config that the constructors and `settings` do not accept."""
    levels = rooms()
    root = get_type_hints(Root, include_extras=True)
    given = {key: value for key, value in plain.items() if key not in levels}
    evaluation = given.pop("evaluation", {})
    yield from schema.problems_of_mapping(given, root, "", root)
    yield from _problems_of_evaluation(evaluation)
    for room in levels:
        section = plain.get(room)
        if room in SEVERAL and isinstance(section, dict):
            for name, level in section.items():
                yield from _problems_of_section(level, f"{room}.{name}", room)
        else:
            yield from _problems_of_section(section, room, room)


def _problems_of_section(section: Any, key: str, room: str) -> Iterator[schema.Problem]:
    if isinstance(section, dict):
        yield from schema.problems_of_level(section, key, room)
    else:
        valid = schema.choices(str(section), rooms()[room])
        yield schema.Problem(key, f"must be one level of its room; {valid}")


def _problems_of_evaluation(section: Any) -> Iterator[schema.Problem]:
    if isinstance(section, dict):
        types = get_type_hints(Evaluation, include_extras=True)
        required = [name for name in types if name in Evaluation.__required_keys__]
        yield from schema.problems_of_mapping(section, types, "evaluation.", required)
    else:
        yield schema.Problem("evaluation", "must be a section; set its keys one by one")


@contextmanager
def own_hydra() -> Iterator[None]:
    """Hydra with our config folder, also inside somebody else's Hydra program or sweep."""
    theirs = get_gh_backup()
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            yield
    finally:
        restore_gh_from_backup(theirs)


def _composed(parsed: Sequence[Override]) -> DictConfig:
    """Hydra's composition. Raises BadInput that names the key Hydra stumbled over."""
    with own_hydra():
        try:
            return compose("config", [o.input_line or "" for o in parsed])
        except HydraException as error:
            raise BadInput(_why_not(parsed, error)) from None


def _why_not(parsed: Sequence[Override], error: HydraException) -> str:
    chosen = [o.input_line or "" for o in parsed if o.key_or_group in groups()]
    known = container(compose("config", chosen))
    for key in (o.key_or_group for o in parsed if o.input_line not in chosen):
        if key not in set(_keys(known)):
            return _unknown(key, known)
    sections = [o.key_or_group for o in parsed if isinstance(o.value(), dict)]
    return f"{sections[0]}: set a section's keys one by one" if sections else _first_line(error)


def groups() -> dict[str, list[str]]:
    """The folders of `conf/`, rooms and presets, and the yaml files of each."""
    return {
        folder.name: sorted(path.stem for path in folder.glob("*.yaml"))
        for folder in sorted(conf_folder().iterdir())
        if folder.is_dir()
    }


def _check_level(override: Override) -> None:
    """Raises BadInput when a room is given something that is not one of its levels."""
    levels = groups().get(override.key_or_group)
    if levels is None or override.is_sweep_override():
        return
    value = override.value()
    wanted = value if isinstance(value, list) and override.key_or_group in SEVERAL else [value]
    if override.key_or_group in PRESETS and value is None:
        return
    if len({str(level) for level in wanted}) < len(wanted):
        text = override.get_value_element_as_str()
        raise BadInput(f"{override.key_or_group}={text}: names a level twice; once is valid")
    for level in wanted:
        if not isinstance(level, str) or level not in levels:
            text = override.get_value_element_as_str()
            valid = schema.choices(str(level), levels)
            raise BadInput(f"{override.key_or_group}={text}: no such level; {valid}")


def _unreadable(text: str) -> str:
    """The message for a setting that is none, or whose value needs quotes."""
    key, equals, value = text.partition("=")
    if not key.strip() or not equals:
        return f"{text!r} is not a setting; write KEY=VALUE, such as seed=1"
    return f"{key}: cannot read {value!r}; quote special characters: \"{key}='...'\""


def _unknown(key: str, known: Mapping[str, Any]) -> str:
    """The message for a key that the config does not have."""
    parent, _, last = key.rpartition(".")
    room, _, level = parent.partition(".")
    if room in SEVERAL and level in rooms()[room] and level not in known[room]:
        taken = ",".join(known[room])
        return f"{key}: {level} is not in {room}=[{taken}]; take it, as in {room}=[{taken},{level}]"
    siblings = [
        k.removeprefix(f"{parent}.") if parent else k
        for k in _keys(known)
        if k.rpartition(".")[0] == parent
    ]
    if siblings:
        return f"{key}: no such key; {schema.choices(last, siblings)}"
    return f"{key}: no such key; {schema.choices(key.partition('.')[0], known)}"


def _keys(tree: Any, prefix: str = "") -> Iterator[str]:
    """Every dotted key of nested mappings, inner ones included."""
    for key, value in tree.items():
        yield f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _keys(value, f"{prefix}{key}.")


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
