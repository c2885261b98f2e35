"""Numbers of frames that must fit each other, known without torch: a wrong one costs no second."""

from collections.abc import Mapping
from typing import Any

from marl_clean.config.installed import is_installed
from marl_clean.errors import BadInput
from marl_clean.settings import Collectors

IN_THE_TRAINER = Collectors()


def check_frames(trainer: Mapping[str, Any], num_envs: int) -> None:
    """Raises BadInput where a training loop's numbers of frames do not fit each other or the env.

    `trainer` holds the settings of either loop by name.
    """
    for key in ("buffer_frames", "batch_frames"):
        if key in trainer and trainer[key] < trainer["window_frames"]:
            raise BadInput(
                f"trainer.{key}={trainer[key]}: must hold at least"
                f" trainer.window_frames={trainer['window_frames']}"
            )
    block = trainer["frames_per_batch"]
    if block % num_envs:
        near = max(1, block // num_envs) * num_envs
        raise BadInput(
            f"trainer.frames_per_batch={block}: must be a multiple of"
            f" env.num_envs={num_envs}, such as {near}"
        )
    collectors = trainer.get("collectors", IN_THE_TRAINER)
    check_collectors(collectors.backend, collectors.num, num_envs)
    if block % trainer.get("minibatch_frames", block):
        raise BadInput(
            f"trainer.minibatch_frames={trainer['minibatch_frames']}: must divide"
            f" trainer.frames_per_batch={block}"
        )


def check_collectors(backend: str, num: int, num_envs: int) -> None:
    """Raises BadInput where worlds cannot be shared out to the collectors, or Ray is missing."""
    if backend == "none" and num != 1:
        raise BadInput(
            f"trainer.collectors.num={num}: needs trainer.collectors.backend=process or ray"
        )
    if num_envs % num:
        valid = ", ".join(str(n) for n in range(1, num_envs + 1) if num_envs % n == 0)
        raise BadInput(
            f"trainer.collectors.num={num}: must divide env.num_envs={num_envs}; valid: {valid}"
        )
    if backend == "ray" and not is_installed("ray"):
        raise BadInput(
            "trainer.collectors.backend=ray: Ray is not installed; pip install 'marl-clean[ray]'"
        )
