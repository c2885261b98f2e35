"""What is set after each block: by progress, and by the share of recent episodes finished."""

import torch
from jaxtyping import Bool
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.env.transformed import TransformedWorlds
from marl_clean.learning.agent import Agent

WINDOW_EPISODES = 500  # older episodes have a weight of e^-1 or less


class Annealing:
    """Sets exploration, step size and discount by progress and the share of episodes finished.

    The share is an exponential moving average: each episode weighs 1 / 500 more than the one
    before it, and it starts at 0.

    Attributes:
        share: of recent episodes that ended with every cell cleaned, from 0 to 1.
    """

    def __init__(self) -> None:
        self.share = 0.0

    def note(self, done: Bool[Tensor, "env time"], finished: Bool[Tensor, "env time"]) -> None:
        """Count the episodes that ended in a block, all with the same weight."""
        ended, cleaned = torch.stack([done.sum(), (done & finished).sum()]).tolist()
        if ended:
            kept = (1 - 1 / WINDOW_EPISODES) ** ended
            self.share = kept * self.share + (1 - kept) * cleaned / ended

    def set(self, agent: Agent, env: EnvBase, progress: float) -> None:
        """Set agent and env for a run's `progress`, from 0 to 1.

        Shaping uses the discount that the agent learns with from now on.
        """
        agent.anneal(progress, self.share)
        if isinstance(env, TransformedWorlds):
            env.set_gamma(agent.gamma)
