"""An engineered message without a choice: the cells around the sender, as they are."""

from typing import ClassVar, final

from marl_clean.comm._quiet import Quiet
from marl_clean.comm.base import Width
from marl_clean.settings import Tells


@final
class Patch(Quiet):
    """Robots in contact tell each other what they know of the 7 x 7 cells around them.

    A bound for `comm=autoencoder`, whose messages are such patches through a learnt code: what
    patches are worth that nothing is lost of. The env keeps them for the hearers, as
    `marl_clean.world.patches` says; the network sends nothing and returns the features unchanged.
    A message has two bits a cell, 98; of the cells of one kind alone a bit, 49.

    Needs `env.memory=private`, and messages cross no channel.

    Source: ours.

    Args:
        in_features: length of the encoder's features.
        tells: of all cells, or of those alone that have been cleaned or are blocked: which of
            them a message pays for.
    """

    exchanges: ClassVar[str] = "patches"
    fits: ClassVar[dict[str, list[str]]] = {"env": ["cleaning"], "channel": ["perfect"]}
    engineered: ClassVar[bool] = True

    def __init__(self, in_features: Width, tells: Tells) -> None:
        super().__init__(in_features)
        self.tells = tells
