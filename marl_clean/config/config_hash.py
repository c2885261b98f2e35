"""What decides a run's result, as one number: runs of the same hash are the same run."""

import hashlib
import json
from typing import Any

from omegaconf import DictConfig, OmegaConf

OUTSIDE_THE_HASH = ("hydra", "name", "device", "logger", "checkpoint", "out")
UNLESS_NULL = ("weights", "parameter_budget")


def config_hash(config: DictConfig) -> str:
    """sha256 over sorted compact JSON of what decides a run's result.

    Keys of `UNLESS_NULL` came later: without a value the hash is what it was before them.
    """
    content = {
        key: value
        for key, value in container(config).items()
        if key not in OUTSIDE_THE_HASH and not (key in UNLESS_NULL and value is None)
    }
    if len(stack := list(content.get("channel", ()))) > 1:
        content["channel order"] = stack  # keys are sorted, and what crosses first matters
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def container(config: DictConfig) -> dict[str, Any]:
    """The config as plain data, `${...}` as it stands."""
    plain = OmegaConf.to_container(config, resolve=False)
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}
