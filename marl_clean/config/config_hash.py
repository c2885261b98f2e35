"""What decides a run's result, as one number: runs of the same hash are the same run."""

import hashlib
import json
from typing import Any

from omegaconf import DictConfig, OmegaConf

OUTSIDE_THE_HASH = ("hydra", "name", "device", "logger", "checkpoint", "out")
LATER: dict[str, Any] = {
    "weights": None,
    "parameter_budget": None,
    "house.free_colours": None,
    "house.margins": [[0, 0]],
    "encoder.norm": "none",
    "comm.places": False,
    "comm.join": "concat",
    "comm.ground": {"sender_map": 0.0, "missing": 0.0, "only": False},
    "env.starts": "anywhere",
    "env.wall_pays": 2.0,
    "env.shaping": 0.0,
    "env.spills": {"per_episode": 0, "noticed_within": None, "size": 2, "pays": 2.0},
    "env.paid_by": "own_map",
    "env.collision_pays": 0.0,
    "env.robots_shown": True,
    "env.robots_noted": False,
    "agent.mask_walls": False,
    "trainer.imitate": None,
    "trainer.imitate_frames_share": 0.1,
    "trainer.imitate_states": "planner",
    "trainer.collectors": {"backend": "none", "num": 1},
    "agent.gamma_end": None,
    "agent.gamma_rises_with": "progress",
    "agent.entropy_coeff_end": None,
    "agent.zero_head": False,
    "agent.play": "argmax",
    "agent.critic": None,
    "agent.critic_memory": "none",
    "agent.normalize_value": False,
    "evaluation.sides": [],
    "observation.news": False,
}
"""Keys added later, each with the value that reproduces what was before there was a key."""


def config_hash(config: DictConfig) -> str:
    """sha256 over sorted compact JSON of what decides a run's result.

    Keys of `LATER` that have their earlier value leave the hash what it was before them.
    """
    content = {
        key: _without_later(value, f"{key}.") if isinstance(value, dict) else value
        for key, value in _without_later(container(config)).items()
        if key not in OUTSIDE_THE_HASH
    }
    if len(stack := list(content.get("channel", ()))) > 1:
        content["channel order"] = stack  # keys are sorted, and what crosses first matters
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _without_later(section: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """The section without the keys of `LATER` that have their earlier value."""
    return {
        key: value
        for key, value in section.items()
        if f"{prefix}{key}" not in LATER or value != LATER[f"{prefix}{key}"]
    }


def container(config: DictConfig) -> dict[str, Any]:
    """The config as plain data, `${...}` as it stands."""
    plain = OmegaConf.to_container(config, resolve=False)
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}
