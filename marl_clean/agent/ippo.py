"""Independent PPO: each robot's critic knows what that robot sees."""

from typing import final

from torchrl.objectives import IPPOLoss

from marl_clean.learning.ppo import Ppo


@final
class Ippo(Ppo):
    """Every robot learns its policy by PPO, and the value of what it sees itself.

    All else as in `marl_clean.learning.ppo.Ppo`. Source: arXiv 2011.09533; TorchRL's loss.
    """

    knows = "local"
    loss_class = IPPOLoss
