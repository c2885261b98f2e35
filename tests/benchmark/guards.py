"""What guards and checkpoints cost of a training: `python -m tests.benchmark.guards [SETTING ...]`.

Guards look for NaN and infinity in every block and in the learner; a checkpoint is the state that a
run resumes from. Both are shares of the time that the same process plays and learns in, so that a
busy machine changes them little. Without settings: the defaults, off policy.
"""

import logging
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import torch

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer import _owed, base
from marl_clean.trainer.base import TrainingLoop

WARM_UP, BLOCKS, SAVES = 2, 10, 3
GUARDS = ((base, "check_numbers"), (base, "check_learner"), (_owed, "check_learner"))


def loop_of(settings: list[str], folder: Path) -> TrainingLoop:
    """Return a training whose learner learns from the first block on."""
    config = compose_config(settings)
    if "start_frames" in config.trainer:
        config.trainer.start_frames = 0
    env = build.make_env(config)
    agent = build.make_agent(config, env)
    trainer = instantiate(config.trainer)
    ready = build.ready_for(agent, env)
    return trainer.begin(ready, agent, lambda policy: {}, [], Checkpoints(folder))


def seconds_of(loop: TrainingLoop) -> tuple[float, float]:
    """Return the seconds of some blocks, and those of them that guards took."""
    spent = 0.0

    def timed(guard: Callable[..., None]) -> Callable[..., None]:
        def run(*arguments: Any) -> None:
            nonlocal spent
            began = time.perf_counter()
            guard(*arguments)
            spent += time.perf_counter() - began

        return run

    with ExitStack() as stack:
        for module, name in GUARDS:
            guard = getattr(module, name)
            stack.enter_context(mock.patch.object(module, name, timed(guard)))
        began = time.perf_counter()
        for _ in range(BLOCKS):
            loop.learn(loop.collect())
        return time.perf_counter() - began, spent


def main(settings: list[str]) -> None:
    torch.set_num_threads(1)
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        loop = loop_of(settings, Path(folder))
        for _ in range(WARM_UP):
            loop.learn(loop.collect())
        seconds, guards = seconds_of(loop)
        saving = []
        for number in range(SAVES):
            loop.frames += number  # another checkpoint
            began = time.perf_counter()
            loop.save()
            saving.append(time.perf_counter() - began)
        loop.close()
    frames = BLOCKS * loop.settings.frames_per_batch
    between = loop.settings.checkpoint_interval_frames * seconds / frames
    sys.stdout.write(
        f"{' '.join(settings) or 'defaults'}: {frames / seconds:,.0f} frames/s; guards"
        f" {100 * guards / seconds:.2f} %, checkpoints {100 * min(saving) / between:.2f} %"
        f" ({min(saving):.2f} s every {between:.0f} s)\n"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
