"""What is set anew after a block: by progress, and by how many late episodes were finished."""

import torch
from jaxtyping import Bool
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.env.transformed import TransformedWorlds
from marl_clean.learning.agent import Agent

WINDOW_EPISODES = 500  # those longer ago count for e^-1 or less


class Annealing:
    """Sets exploration, step size and discount by the share of late episodes that were finished.

    It forgets exponentially: each episode weighs 1 / 500 more than the one before, and what was
    before the first counts as not finished.

    Attributes:
        share: of late episodes that ended with every cell cleaned, from 0 to 1.
    """

    def __init__(self) -> None:
        self.share = 0.0

    def note(self, done: Bool[Tensor, "env time"], finished: Bool[Tensor, "env time"]) -> None:
        """Count the episodes that ended in a block; within it all weigh alike."""
        ended, well = torch.stack([done.sum(), (done & finished).sum()]).tolist()
        if ended:
            kept = (1 - 1 / WINDOW_EPISODES) ** ended
            self.share = kept * self.share + (1 - kept) * well / ended

    def set(self, agent: Agent, env: EnvBase, progress: float) -> None:
        """Let agent and env go on as is due where `progress`, from 0 to 1, of a run is done.

        Shaping pays by the discount that the agent learns with from now on.
        """
        agent.anneal(progress, self.share)
        if isinstance(env, TransformedWorlds):
            env.set_gamma(agent.gamma)
