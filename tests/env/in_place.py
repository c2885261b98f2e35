"""Compiled steps and beginnings write into the maps: they make no map of all worlds anew.

A script of its own, because the run-time checks of the tests cannot be compiled.
"""

import math
import re
from collections.abc import Callable

import torch
from torch._inductor.utils import run_and_get_code

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.env.transformed import TransformedWorlds

WORLDS = 64
SETTINGS = [
    "train_houses=8",
    f"env.num_envs={WORLDS}",
    "env.n_agents=3",
    "env.compile=true",
]
SIZE = re.compile(r"empty_strided_\w+\(\(([\d, ]+)\)")


def main() -> None:
    env = build.make_env(compose_config(SETTINGS))
    env.reset()
    check(env, step(env))
    check(env, lambda: env.base_env.begin_rows(torch.tensor([3, 5])))
    for settings in (["env.memory=private"], ["env.sensor=touch4"]):
        env = build.make_env(compose_config([*SETTINGS, *settings]))
        check(env, step(env))
    matrix, index = torch.zeros(WORLDS, 10, 10), torch.arange(5)
    _, codes = run_and_get_code(torch.compile(scatter), matrix, index)
    assert largest(codes) == matrix.numel(), "a map that is copied would not be noticed"


def step(env: TransformedWorlds) -> Callable[[], object]:
    action = torch.zeros(env.base_env.state.moved.shape, dtype=torch.int64)
    return lambda: env.base_env.step_worlds(action)


def check(env: TransformedWorlds, call: Callable[[], object]) -> None:
    _, codes = run_and_get_code(call)
    assert 0 < largest(codes) < env.base_env.state.visited.numel()


def scatter(matrix: torch.Tensor, index: torch.Tensor) -> None:
    matrix.view(-1).scatter_(0, index, 1.0)


def largest(codes: list[str]) -> int:
    """Return the numbers in the largest tensor that compiled code makes."""
    sizes = [size for code in codes for size in SIZE.findall(code)]
    return max((math.prod(map(int, re.findall(r"\d+", size))) for size in sizes), default=0)


if __name__ == "__main__":
    main()
