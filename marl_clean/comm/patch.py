"""An engineered message without a choice: the cells around the sender, as they are."""

from typing import ClassVar, Literal, final

from marl_clean.comm._quiet import Quiet


@final
class Patch(Quiet):
    """Robots in contact tell each other what they know of the 7 x 7 cells around them.

    A bound for `comm=autoencoder`, whose messages are such patches through a learnt code: what
    patches are worth that nothing is lost of. The env keeps them for the hearers, as
    `marl_clean.world.patches` says; the network sends nothing and returns the features unchanged.
    A message has two bits a cell, 98.

    Needs `env.memory=private`, and messages cross no channel.

    Source: ours.

    Args:
        in_features: length of the encoder's features.
    """

    exchanges: ClassVar[Literal["cells", "maps", "patches", "codes"]] = "patches"
    fits: ClassVar[dict[str, list[str]]] = {"env": ["cleaning"], "channel": ["perfect"]}
    engineered: ClassVar[bool] = True
