"""The true state of the world, as a transform: for mixers and critics in learning, for no robot."""

import torch
from jaxtyping import Bool
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries

PLANES = ("blocked", "cleaned", "robots")


class GlobalState(WorldTransform):
    """Adds `"state"`, bool `[*B, 3, R, C]`: blocked cells, cleaned cells (no spilt
    ones), robots.

    R and C are those of the largest house; a smaller house is padded with blocked cells below and
    to the right.
    """

    def read(self, state: State, setup: Setup) -> Entries:
        return {keys.STATE: planes(state, setup.rules.margin)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = planes(env.state, env.rules.margin).shape
        return {keys.STATE: Binary(shape=shape, dtype=torch.bool, device=env.device)}


def planes(state: State, margin: int) -> Bool[Tensor, "env plane row col"]:
    """Return the true state as boolean planes."""
    inner = slice(margin, -margin)
    blocked, cleaned = (m[:, inner, inner] for m in (state.blocked, state.visited))
    if state.spilt is not None:
        cleaned = cleaned & ~state.spilt[:, inner, inner]
    robots = torch.zeros_like(blocked)
    world = torch.arange(len(robots), device=robots.device)[:, None]
    robots[world, state.position[..., 0], state.position[..., 1]] = True
    return torch.stack([blocked, cleaned, robots], dim=1)
