"""What a step of `any_house`'s env and its training cost with more and more worlds, on any device.

`python -m tests.benchmark.worlds 256 1024 4096 [key=value ...]`, such as `device=cuda`.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from rich.table import Table

from marl_clean import build
from marl_clean.commands._benchmark_training import PRESETS, Session
from marl_clean.commands.benchmark import env_stepper
from marl_clean.config.compose import compose_config
from marl_clean.evaluation.table import output

PRESET = "any_house"
WARM_STEPS, STEPS = 10, 30
TRAINING_SECONDS = 5.0
BLOCK_STEPS, MINIBATCHES = 16, 8  # of each world in a block; of a block in an epoch
GIB = 2**30


def row(worlds: int, settings: Sequence[str]) -> list[str]:
    """The cells of one number of worlds."""
    frames = worlds * BLOCK_STEPS
    overrides = [f"+experiment={PRESET}", f"env.num_envs={worlds}", *PRESETS[PRESET]]
    overrides += [f"trainer.frames_per_batch={frames}"]
    overrides += [f"trainer.minibatch_frames={frames // MINIBATCHES}", *settings]
    env = build.make_env(compose_config(overrides))
    robots, on_gpu = env.base_env.n_agents, env.device.type == "cuda"
    if on_gpu:
        torch.cuda.reset_peak_memory_stats(env.device)
    run = env_stepper(env)
    run(WARM_STEPS)
    began = time.perf_counter()
    run(STEPS)
    step = (time.perf_counter() - began) / STEPS
    with tempfile.TemporaryDirectory() as folder:
        session = Session(overrides, Path(folder))
        session.run(0.0)
        session.reset_clocks()
        speed = session.run(TRAINING_SECONDS) * robots
    # By the host's clock, which on a GPU runs on while a queue of kernels is worked off.
    shares = {part: seconds / session.elapsed for part, seconds in session.seconds.items()}
    shares["step"] -= shares["observation"]
    memory = torch.cuda.max_memory_allocated(env.device) / GIB if on_gpu else None
    return [
        f"{worlds:,}",
        f"{step * 1e3:.1f}",
        f"{worlds * robots / step:,.0f}",
        f"{speed:,.0f}",
        ", ".join(f"{share:.2f}" for share in shares.values()),
        "" if memory is None else f"{memory:.1f}",
    ]


def main(arguments: Sequence[str]) -> None:
    """Print a row for every number of worlds."""
    table = Table(title=f"{PRESET}, random actions and training after the warm start")
    titles = ("worlds", "ms a step", "robot-steps/s, env", "robot-steps/s, training")
    for title in (*titles, "observation, world, acting, learning", "GPU memory, GiB"):
        table.add_column(title, justify="right")
    settings = [argument for argument in arguments if "=" in argument]
    for worlds in (int(argument) for argument in arguments if "=" not in argument):
        table.add_row(*row(worlds, settings))
    output().print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
