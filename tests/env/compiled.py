"""Play compiled envs beside plain ones: all that they carry on is the same.

A script of its own, because the run-time checks of the tests cannot be compiled. With arguments,
of these settings instead, such as `observation=pyramid env.memory=private`.
"""

import sys

import torch

from marl_clean import build, keys
from marl_clean.config.compose import compose_config

WORLDS = 12
SMALL = [
    "train_houses=8",
    "house.rows=[4,6]",
    "house.cols=[4,7]",
    f"env.num_envs={WORLDS}",
    "env.n_agents=3",
    "env.stuck_after=5",
]
NOISE = ["env.bump_noise=0.3", "observation.position_noise=0.3"]
CASES = [[], ["observation=frontier", "env.memory=private", *NOISE]]


def main() -> None:
    torch._dynamo.config.fail_on_recompile_limit_hit = True  # not silently uncompiled
    given = [sys.argv[1:]] if sys.argv[1:] else CASES
    for settings in given:
        check(settings)


def check(settings: list[str]) -> None:
    plain, compiled = (
        build.make_env(compose_config([*SMALL, *settings, f"env.compile={how}"]))
        for how in (False, True)
    )
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


if __name__ == "__main__":
    main()
