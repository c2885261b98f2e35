"""A robot may send only so many messages in a step."""

from typing import final

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.channel.base import Channel
from marl_clean.settings import NonNegativeInt


@final
class Budget(Channel):
    """Let each robot send at most so many messages a step, to its nearest neighbours.

    A message is one round over one edge, so a scheme of K rounds talks to `messages // K` robots.
    A robot that is not written to costs nothing.

    Args:
        messages: the most messages of one robot in one step.
    """

    def __init__(self, messages: NonNegativeInt) -> None:
        super().__init__()
        self.messages = messages

    def address(
        self,
        edges: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
        rounds: int,
    ) -> Bool[Tensor, "*batch agent other"]:
        receivers = edges.mT  # [j, i]: j may write to i
        last = torch.full_like(distance_rank, edges.shape[-1])
        place = torch.where(receivers, distance_rank, last).argsort(-1).argsort(-1)
        return (receivers & (place < self.messages // max(1, rounds))).mT
