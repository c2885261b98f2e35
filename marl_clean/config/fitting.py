"""Which levels fit each other: read from their classes, before torch is imported."""

from typing import Any

from omegaconf import DictConfig

from marl_clean.config.class_source import constant, takes
from marl_clean.config.levels import SEVERAL, level_of, read_level, rooms
from marl_clean.errors import BadInput
from marl_clean.settings import Form

UNSEEN = "crop"  # the default config's: what an external task is composed with, and never shows


def check_fit(config: DictConfig) -> None:
    """Raises BadInput when two levels do not go together.

    A class may list in `fits` which levels of other rooms it goes with; an encoder `takes` the
    form that the observation, or an external task, `gives`; only squares can be rotated.
    """
    targets = {
        str(room): str(section["_target_"])
        for room, section in config.items()
        if _is_level(section)
    }
    for room, target in targets.items():
        fits: dict[str, list[str]] = constant(target, "fits") or {}
        for other, valid in fits.items():
            levels = list(config[other]) if other in SEVERAL else [level_of(targets[other])]
            for level in levels:
                if level not in valid:
                    fitting = f"{room}={level_of(target)}; valid: {', '.join(valid)}"
                    raise BadInput(f"{other}={level}: does not fit {fitting}")
    source = "observation" if constant(targets["env"], "gives") is None else "env"
    gives, expects = constant(targets[source], "gives"), constant(targets["encoder"], "takes")
    source_form = f"{source}={level_of(targets[source])} gives {gives.value}"
    if gives is not expects:
        raise BadInput(
            f"encoder={level_of(targets['encoder'])}: takes {expects.value}, {source_form};"
            f" valid: {', '.join(encoders_of(gives))}"
        )
    if gives is not Form.SQUARES and config.agent.get("augment", False):
        raise BadInput(f"agent.augment=true: rotates squares, {source_form}; valid: false")
    observation = level_of(targets["observation"])
    if observation != UNSEEN and not takes(targets["env"], "houses"):
        env = f"env={level_of(targets['env'])} shows robots what it likes"
        raise BadInput(f"observation={observation}: {env}; valid: no observation at all")
    if config.agent.get("mask_walls", False) and not takes(targets["env"], "houses"):
        env = f"env={level_of(targets['env'])}"
        raise BadInput(
            f"agent.mask_walls=true: a mask where there are no walls, {env}; valid: false"
        )
    if constant(targets["comm"], "exchanges") and config.env.memory != "private":
        comm = f"comm={level_of(targets['comm'])} exchanges parts of private maps"
        raise BadInput(f"env.memory={config.env.memory}: {comm}; valid: private")
    if config.comm.get("places", False) and not takes(targets["env"], "houses"):
        env = f"env={level_of(targets['env'])} has no positions"
        raise BadInput(f"comm.places=true: {env}; valid: false")
    _check_ground(config, targets)
    if config.agent.get("critic") == "state" and not takes(targets["env"], "houses"):
        env = f"env={level_of(targets['env'])} shows no true state"
        raise BadInput(f"agent.critic=state: {env}; valid: local, robots, null")


def _check_ground(config: DictConfig, targets: dict[str, str]) -> None:
    """Raises BadInput where messages cannot be learnt from what the env or the learner has."""
    ground = config.comm.get("ground", {})
    weights = [name for name in ("sender_map", "missing") if ground.get(name, 0) > 0]
    if ground.get("only", False) and not weights:
        raise BadInput(
            "comm.ground.only=true: messages learn from nothing then; valid: false, or"
            " comm.ground.sender_map or comm.ground.missing above 0"
        )
    if not weights:
        return
    key = f"comm.ground.{weights[0]}={ground[weights[0]]}"
    if constant(targets["comm"], "engineered"):
        comm = f"comm={level_of(targets['comm'])}"
        raise BadInput(f"{key}: nothing of the messages of {comm} is learnt; valid: 0")
    if not takes(targets["env"], "houses"):
        raise BadInput(f"{key}: env={level_of(targets['env'])} has no maps; valid: 0")
    if "missing" in weights and config.env.memory != "private":
        raise BadInput(
            f"comm.ground.missing={ground['missing']}: under env.memory={config.env.memory} robots"
            " in contact miss nothing of each other's; valid: 0, or env.memory=private"
        )


def encoders_of(form: Form) -> list[str]:
    """The encoders that take a form of observation."""
    sections = ((level, read_level("encoder", level)) for level in rooms()["encoder"])
    return [level for level, section in sections if constant(section["_target_"], "takes") is form]


def _is_level(section: Any) -> bool:
    return isinstance(section, DictConfig) and "_target_" in section
