"""From `key=value` settings to one checked config, before torch is imported.

Hydra composes the defaults of `conf/` with the settings, `schema` holds the result against the
constructors' signatures, and what is wrong becomes one line.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_type_hints

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from marl_clean.config import class_source, hydra_adapter, schema
from marl_clean.config.config_hash import config_hash, container
from marl_clean.config.hydra_adapter import Override, first_line
from marl_clean.config.levels import EXPERIMENT, PRESETS, SEVERAL, groups, level_file, rooms
from marl_clean.config.overrides import check_single_values, parse_overrides
from marl_clean.config.presets import read_preset
from marl_clean.config.sections import Evaluation, Root
from marl_clean.errors import BadInput

PERFECT = {"perfect": {"_target_": "marl_clean.channel.perfect.Perfect"}}


def compose_config(overrides: Sequence[str] = ()) -> DictConfig:
    """The config that `overrides` describe, checked and resolved.

    Raises BadInput on what cannot be read, is unknown, or has a wrong type or value.
    """
    return compose_parsed(parse_overrides(overrides))


def compose_parsed(parsed: Sequence[Override]) -> DictConfig:
    """`compose_config` of settings that have been read already."""
    check_single_values(parsed)
    return checked(resolved(_composed(parsed)), parsed)


def unchecked(overrides: Sequence[str]) -> dict[str, Any]:
    """The config that `overrides` describe as it stands: nothing is resolved or checked.

    Raises BadInput on what cannot be read, and for a level or key that does not exist.
    """
    return container(_composed(parse_overrides(overrides)))


def has_houses(config: DictConfig) -> bool:
    """Whether the config's env has houses; an external task has none."""
    return class_source.takes(config.env._target_, "houses")


def apply(config: dict[str, Any], parsed: Sequence[Override]) -> dict[str, Any]:
    """`config` of an earlier run, with presets, then overridden levels and values on top."""
    check_single_values(parsed)
    levels: dict[str, Any] = {}
    sets: list[dict[str, Any]] = []
    for group in PRESETS:
        for name in [o.value for o in parsed if o.key == group][-1:]:
            if name is not None:
                chosen, values = read_preset(level_file(group, name))
                levels |= chosen
                sets += values
    levels |= {o.key: o.value for o in parsed if o.key in rooms()}
    composed = container(_composed(parse_overrides([f"{k}={v}" for k, v in levels.items()])))
    chosen_levels = {room: composed[room] for room in levels}
    merged = OmegaConf.create(config | chosen_levels)
    merged.merge_with(*sets)
    known = container(merged)
    for override in parsed:
        key = override.key
        if key in groups():
            continue
        if key not in set(dotted_keys(known)):
            raise BadInput(_unknown(key, known))
        OmegaConf.update(merged, key, override.value, merge=True)
    return resolved(merged)


def resolved(config: DictConfig) -> dict[str, Any]:
    """The config as plain data, every `${...}` replaced. Raises BadInput where one cannot be."""
    try:
        plain = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise BadInput(f"{error.full_key}: {first_line(error)}") from None
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def check(plain: dict[str, Any], parsed: Sequence[Override] = ()) -> dict[str, Any]:
    """`plain` with the rooms that may be left out. Raises BadInput when the schema refuses it."""
    plain = {**plain, "logger": plain.get("logger") or {}}  # no logger at all is valid
    plain["channel"] = plain.get("channel") or PERFECT
    problems = list(_problems(plain))
    if problems:
        overridden = {override.key for override in parsed}
        first = next((p for p in problems if p.key in overridden), problems[0])
        raise BadInput(f"{first.key}: {first.reason}")
    return plain


def checked(plain: dict[str, Any], parsed: Sequence[Override] = ()) -> DictConfig:
    """`plain` as a config with its `name` filled in. Raises BadInput when the schema refuses."""
    plain = check(plain, parsed)
    config = OmegaConf.create(plain)
    if config.name is None:
        presets = [o.value for o in parsed if o.key == EXPERIMENT]
        config.name = f"{(presets and presets[-1]) or 'run'}-{config_hash(config)[:8]}"
    OmegaConf.set_struct(config, True)
    return config


def _problems(plain: Mapping[str, Any]) -> Iterator[schema.Problem]:
    """Everything in the config that the constructors and `settings` do not accept."""
    levels = rooms()
    root = get_type_hints(Root, include_extras=True)
    root_values = {key: value for key, value in plain.items() if key not in levels}
    evaluation = root_values.pop("evaluation", {})
    yield from schema.problems_of_mapping(root_values, root, "", root)
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


def _composed(parsed: Sequence[Override]) -> DictConfig:
    """Hydra's composition. Raises BadInput that names the key at fault."""
    try:
        return hydra_adapter.compose(parsed)
    except hydra_adapter.NotComposed as error:
        raise BadInput(_composition_error(parsed, str(error))) from None


def _composition_error(parsed: Sequence[Override], hydra_message: str) -> str:
    """The message for settings that make no config: the key at fault, else Hydra's own words."""
    chosen = [override for override in parsed if override.key in groups()]
    known = container(hydra_adapter.compose(chosen))
    for key in (override.key for override in parsed if override not in chosen):
        if key not in set(dotted_keys(known)):
            return _unknown(key, known)
    nested = {key.rpartition(".")[0] for key in dotted_keys(known)}
    sections = [
        override.key
        for override in parsed
        if isinstance(override.value, dict) or override.key in nested - {*rooms()}
    ]
    return f"{sections[0]}: set a section's keys one by one" if sections else hydra_message


def _unknown(key: str, known: Mapping[str, Any]) -> str:
    """The message for a key that the config does not have."""
    parent, _, last = key.rpartition(".")
    room, _, level = parent.partition(".")
    if room in SEVERAL and level in rooms()[room] and level not in known[room]:
        chosen = ",".join(known[room])
        listed = f"{room}=[{chosen}]"
        return f"{key}: {level} is not in {listed}; add it, as in {room}=[{chosen},{level}]"
    siblings = [
        k.removeprefix(f"{parent}.") if parent else k
        for k in dotted_keys(known)
        if k.rpartition(".")[0] == parent
    ]
    if siblings:
        return f"{key}: no such key; {schema.choices(last, siblings)}"
    return f"{key}: no such key; {schema.choices(key.partition('.')[0], known)}"


def dotted_keys(tree: Any, prefix: str = "") -> Iterator[str]:
    """Every dotted key of nested mappings, inner ones included."""
    for key, value in tree.items():
        yield f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from dotted_keys(value, f"{prefix}{key}.")


def leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every value in nested mappings that is none itself, under its dotted key."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
