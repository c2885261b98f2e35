"""Play a compiled env beside a plain one: every frame of both is the same.

A script of its own, because the run-time checks of the tests cannot be compiled.
"""

import torch

from marl_clean import build, keys
from marl_clean.compose import compose_config

SETTINGS = [
    "train_houses=8",
    "house.rows=[4,6]",
    "house.cols=[4,7]",
    "env.num_envs=12",
    "env.n_agents=3",
    "env.stuck_after=5",
    "observation.view_size=5",
]


def main() -> None:
    plain, compiled = (
        build.make_env(compose_config([*SETTINGS, f"env.compile={how}"])) for how in (False, True)
    )
    carried = [env.reset() for env in (plain, compiled)]
    generator = torch.Generator().manual_seed(0)
    begun = set()
    for _ in range(40):
        action = torch.randint(4, (12, 3), generator=generator)
        for index, env in enumerate((plain, compiled)):
            carried[index][keys.ACTION] = action
            _, carried[index] = env.step_and_maybe_reset(carried[index])
        begun.add(len(plain.base_env.reset_rows))
        for key in carried[0].keys(True, True):
            torch.testing.assert_close(carried[0][key], carried[1][key], rtol=0, atol=1e-6)
    assert len(begun) > 2, begun  # another number of worlds each time


if __name__ == "__main__":
    main()
