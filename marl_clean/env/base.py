"""What training needs of every level of this room, beyond TorchRL's EnvBase."""

from typing import ClassVar

import torch
from jaxtyping import Int
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.world.random import Purpose


class BatchedEnv(EnvBase):
    """A batch of `num_envs` worlds, each with the same `n_agents` robots.

    What a robot is paid, `("agents", "reward")`, is its only reward; what it earned itself,
    `("agents", "own_reward")`, is an observation, which `marl_clean.reward` turns into the
    payment. Where its constructor has a parameter `houses` it receives the houses of the
    episodes, otherwise the graph of who may talk to whom.

    Attributes:
        resumes_exactly: `load_state_dict` restores the middle of an episode; otherwise a resumed
            run begins new episodes.
    """

    n_agents: int
    num_envs: int
    resumes_exactly: ClassVar[bool] = True

    def draw(self, purpose: Purpose) -> Int[Tensor, "env agent"]:
        """Draw a number in [0, 2^32) for each robot in this step, from torch's generator."""
        return torch.randint(2**32, (self.num_envs, self.n_agents), device=self.device)

    def progress(self) -> dict[str, float]:
        """Return measures of the worlds' present state, for the log."""
        return {}
