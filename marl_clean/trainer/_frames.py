"""Numbers of frames that must fit each other, known without torch: a wrong one costs no second."""

from collections.abc import Mapping
from typing import Any

from marl_clean.errors import BadInput


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
    if block % trainer.get("minibatch_frames", block):
        raise BadInput(
            f"trainer.minibatch_frames={trainer['minibatch_frames']}: must divide"
            f" trainer.frames_per_batch={block}"
        )
