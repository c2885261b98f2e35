"""Jumanji's Cleaner, our nearest relative, timed beside our own world (an extra)."""

import importlib.util
import statistics
import time
from typing import Any


def cleaner_step_seconds(
    num_envs: int, n_agents: int, side: int, repeats: int, steps: int
) -> float | None:
    """Time a step of a jitted, vmapped and scanned Cleaner under random valid actions.

    Returns the median seconds a step of the whole batch; None where Jumanji is not installed
    (`pip install marl-clean[benchmark]`).
    """
    if importlib.util.find_spec("jumanji") is None:
        return None
    import jax
    from jumanji.environments import Cleaner
    from jumanji.environments.routing.cleaner.generator import RandomGenerator

    env = Cleaner(generator=RandomGenerator(side, side, n_agents), time_limit=10**9)

    def step(carry: Any, key: Any) -> Any:
        state, timestep = carry
        valid = timestep.observation.action_mask
        action = jax.random.categorical(key, jax.numpy.where(valid, 0.0, -jax.numpy.inf))
        return jax.vmap(env.step)(state, action), timestep.reward

    @jax.jit
    def play(carry: Any, key: Any) -> Any:
        return jax.lax.scan(step, carry, jax.random.split(key, steps))

    key = jax.random.PRNGKey(0)
    carry = jax.jit(jax.vmap(env.reset))(jax.random.split(key, num_envs))
    carry, _ = jax.block_until_ready(play(carry, key))
    taken = []
    for _ in range(repeats):
        began = time.perf_counter()
        carry, _ = jax.block_until_ready(play(carry, key))
        taken.append((time.perf_counter() - began) / steps)
    return statistics.median(taken)
