"""Errors of sensing: bumps that go unnoticed, robots that mistake their place.

Both are drawn anew for every step and robot, as pure functions of (seed, env index, episode,
step, robot).
"""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world.dynamics import moves_on
from marl_clean.world.random import Purpose, Seed, happens, random_below, words_of_robots
from marl_clean.world.state import State


def unnoticed_bumps(
    state: State, env_index: Int[Tensor, " env"], seed: Seed, probability: float
) -> Bool[Tensor, "env agent"]:
    """Tell which robots will not notice it if they bump in the step to come."""
    return happens(probability, seed, *words_of_robots(state, env_index, Purpose.BUMP))


def believed_position(
    state: State, env_index: Int[Tensor, " env"], seed: Seed, probability: float
) -> Int[Tensor, "env agent 2"]:
    """Return the place that each robot takes for its own: with `probability` one cell off.

    Up, right, down or left, each as likely. It is never outside the house: at its edge some of
    these are the true place.
    """
    words = (seed, *words_of_robots(state, env_index, Purpose.PLACE))
    direction = random_below(4, *words, 1)
    beside = state.position + moves_on(state.position.device)[direction]
    last = torch.stack([state.rows, state.cols], -1)[:, None] - 1
    beside = beside.clamp(min=0).minimum(last)
    return torch.where(happens(probability, *words, 0)[..., None], beside, state.position)
