"""Multi-agent PPO: the critic knows what all robots see, the policies do not."""

from typing import final

from torchrl.objectives import MAPPOLoss

from marl_clean.learning.ppo import Ppo


@final
class Mappo(Ppo):
    """Every robot learns its policy by PPO, and the value of what all robots see.

    The critic joins each robot's features with the mean of all robots', so that it is for any
    number of robots and may differ between them, as their rewards do. All else as in
    `marl_clean.learning.ppo.Ppo`. Source: arXiv 2103.01955; TorchRL's loss.
    """

    knows = "robots"
    loss_class = MAPPOLoss
