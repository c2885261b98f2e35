"""Jumanji's Cleaner, our nearest relative, timed beside our own world (an extra)."""

from collections.abc import Callable
from functools import partial
from typing import Any

from marl_clean.config.installed import is_installed


def cleaner(num_envs: int, n_agents: int, side: int) -> Callable[[int], None] | None:
    """Return a function that runs a number of steps of random valid actions, jitted and scanned.

    None where Jumanji is not installed (`pip install marl-clean[benchmark]`).
    """
    if not is_installed("jumanji"):
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

    @partial(jax.jit, static_argnums=1)
    def scan(carry: Any, count: int) -> Any:
        return jax.lax.scan(step, carry, jax.random.split(key, count))[0]

    key = jax.random.PRNGKey(0)
    carry = jax.jit(jax.vmap(env.reset))(jax.random.split(key, num_envs))

    def run(count: int) -> None:
        nonlocal carry
        carry = jax.block_until_ready(scan(carry, count))

    return run
