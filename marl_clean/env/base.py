"""What training asks of every level of this room, beside TorchRL's EnvBase."""

from typing import ClassVar

import torch
from jaxtyping import Int
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.world.random import Purpose


class BatchedEnv(EnvBase):
    """A batch of `num_envs` worlds, each with the same `n_agents` robots.

    What a robot is paid, `("agents", "reward")`, is its only reward; what it earned itself,
    `("agents", "own_reward")`, is an observation, of which `marl_clean.reward` makes the
    payment. Its constructor is handed the houses to play in where it has a
    parameter `houses`, and who may talk to whom otherwise.

    Attributes:
        resumes_exactly: `load_state_dict` brings back the middle of an episode; otherwise an
            interrupted run begins new episodes.
    """

    n_agents: int
    num_envs: int
    resumes_exactly: ClassVar[bool] = True

    def draw(self, purpose: Purpose) -> Int[Tensor, "env agent"]:
        """Draw a number in [0, 2^32) for each robot in this step, from torch's generator."""
        return torch.randint(2**32, (self.num_envs, self.n_agents), device=self.device)

    def progress(self) -> dict[str, float]:
        """Return what there is to tell of the worlds as they stand, for the log."""
        return {}
