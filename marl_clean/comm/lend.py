"""An engineered message without memory: the sender's whole map, for one step."""

from typing import ClassVar, final

from marl_clean.comm._quiet import Quiet


@final
class Lend(Quiet):
    """Robots in contact see by the union of their private maps, and keep nothing of it.

    A bound for learnt messages, which are gone with the step, too: what a message can be worth
    that holds all the sender knows and is understood perfectly, but is not remembered. The env
    unites the maps before robots observe, as `marl_clean.world.lending` says; the network sends
    nothing and returns the features unchanged. Its bits are those of the whole map in each step.

    Needs `env.memory=private`, and messages cross no channel.

    Source: ours.

    Args:
        in_features: length of the encoder's features.
    """

    exchanges: ClassVar[str] = "maps"
    fits: ClassVar[dict[str, list[str]]] = {"env": ["cleaning"], "channel": ["perfect"]}
    engineered: ClassVar[bool] = True
