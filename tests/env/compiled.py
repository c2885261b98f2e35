"""Compiled envs play what plain ones play, and write into their maps: they make none anew.

A script of its own, because the run-time checks of the tests cannot be compiled. With arguments,
of these settings instead, such as `observation=pyramid env.memory=private`.
"""

import math
import re
import sys
from typing import Any

import torch
from torch._inductor import config as inductor
from torch._inductor.utils import run_and_get_code

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.transformed import TransformedWorlds
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import begin_rows_

WORLDS = 12
SMALL = [
    "train_houses=8",
    "house.rows=[4,6]",
    "house.cols=[4,7]",
    f"env.num_envs={WORLDS}",
    "env.n_agents=3",
    "env.stuck_after=5",
    "observation.view_size=5",  # smaller than a map: the largest tensor made must not be one
]
NOISE = ["env.bump_noise=0.3", "observation.position_noise=0.3"]
LATER = ["env.shaping=0.5", "env.wall_pays=0.5", "env.decay_steps=null", "agent.mask_walls=true"]
SPILLS = ["env.spills.per_episode=3", "env.spills.noticed_within=2"]
TEAM = [
    *("env.paid_by=team_map", "env.collision_pays=-1", "env.robots_shown=false"),
    "env.knowledge=[memorised,unknown,stale]",
]
CAPTURED = ["observation=frontier", "env.memory=private", *NOISE, *LATER, *SPILLS, *TEAM]
STEP = ["env.memory=private", "env.sensor=touch4", *SPILLS]  # of the maps alone
SIZE = re.compile(r"empty_strided_\w+\(\(([\d, ]+)\)")


def main() -> None:
    torch._dynamo.config.fail_on_recompile_limit_hit = True  # not silently uncompiled
    # To find out what vectors the compiler can make takes seconds, and the graphs are the same; so
    # do processes that compile, and fast machine code.
    inductor.cpp.vec_isa_ok = False
    inductor.compile_threads = 1
    inductor.aot_inductor.debug_compile = True
    settings = sys.argv[1:]
    plain, compiled = make(settings), make([*settings, "env.compile=true"])
    if not settings:
        begin_several_wholly(compiled)
    _, codes = run_and_get_code(play_beside, plain, compiled)
    if settings:  # some observations read whole maps, and make as large ones of it
        return
    check_maps_are_kept(compiled, codes)
    # Graphs without machine code, which takes minutes of what is in all of these settings.
    plain, captured = make(CAPTURED), make(CAPTURED)
    captured.base_env.compile(backend="aot_eager", options=None)
    begin_several_wholly(captured)
    play_beside(plain, captured)
    env, action = make([*STEP, "env.compile=true"]), torch.zeros(WORLDS, 3, dtype=torch.int64)
    _, codes = run_and_get_code(env.base_env.step_worlds, action)
    check_maps_are_kept(env, codes)
    matrix, index = torch.zeros(WORLDS, 10, 10), torch.arange(5)
    _, codes = run_and_get_code(torch.compile(scatter), matrix, index)
    assert largest(codes) == matrix.numel(), "a map that is copied would not be noticed"


def make(settings: list[str]) -> TransformedWorlds:
    return build.make_env(compose_config([*SMALL, *settings]))


def begin_several_wholly(env: TransformedWorlds) -> None:
    """Compile beginnings of several worlds that are observed at once; only capture the others.

    One world, and all of them unobserved, are graphs of their own that hold nothing else, and take
    as long to compile.
    """
    several = env.base_env.compiled(begin_rows_)
    captured = torch.compile(begin_rows_, backend="eager", isolate_recompiles=True)

    def begin(state: State, setup: Setup, rows: torch.Tensor, *others: Any) -> Any:
        chosen = several if 1 < len(rows) < WORLDS else captured
        return chosen(state, setup, rows, *others)

    env.base_env._compiled[begin_rows_] = begin


def play_beside(plain: TransformedWorlds, compiled: TransformedWorlds) -> None:
    """Step both with the same actions: all that they carry on is the same."""
    generator = torch.Generator().manual_seed(0)
    for seed in (0, 1):  # another seed is no constant of what is compiled
        for env in (plain, compiled):
            env.set_seed(seed)
        carried = [env.reset() for env in (plain, compiled)]
        begun = set()
        for _ in range(40):
            action = torch.randint(4, (WORLDS, 3), generator=generator)
            for index, env in enumerate((plain, compiled)):
                carried[index][keys.ACTION] = action
                _, carried[index] = env.step_and_maybe_reset(carried[index])
            begun.add(len(plain.base_env.reset_rows))
            for key in carried[0].keys(True, True):
                torch.testing.assert_close(carried[0][key], carried[1][key], rtol=0, atol=1e-6)
        assert len(begun) > 2, begun  # another number of worlds each time


def check_maps_are_kept(env: TransformedWorlds, codes: list[str]) -> None:
    assert 0 < largest(codes) < env.base_env.state.visited.numel()


def scatter(matrix: torch.Tensor, index: torch.Tensor) -> None:
    matrix.view(-1).scatter_(0, index, 1.0)


def largest(codes: list[str]) -> int:
    """Return the numbers in the largest tensor that compiled code makes."""
    sizes = [size for code in codes for size in SIZE.findall(code)]
    return max((math.prod(map(int, re.findall(r"\d+", size))) for size in sizes), default=0)


if __name__ == "__main__":
    main()
