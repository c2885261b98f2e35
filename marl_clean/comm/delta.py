"""An engineered message: the cells that changed in the sender's map."""

from typing import ClassVar, final

from marl_clean.comm._quiet import Quiet
from marl_clean.comm.base import Width
from marl_clean.settings import PositiveInt


@final
class Delta(Quiet):
    """Robots in contact tell each other what is new in their private maps.

    The env merges what is heard into the hearer's map before it observes, as
    `marl_clean.world.exchange` says; the network sends nothing and returns the features unchanged.
    What this costs is counted to the bit. With any number of cells it is `env.memory=merged`, but
    for what changes faster than it is told.

    Needs `env.memory=private`, and messages cross no channel.

    Source: ours; the message that a robotics engineer would send.

    Args:
        in_features: length of the encoder's features.
        cells: how many cells a robot tells another in a step at most, the oldest change first.
    """

    exchanges: ClassVar[str] = "cells"
    fits: ClassVar[dict[str, list[str]]] = {"env": ["cleaning"], "channel": ["perfect"]}
    engineered: ClassVar[bool] = True

    def __init__(self, in_features: Width, cells: PositiveInt) -> None:
        super().__init__(in_features)
        self.cells = cells
