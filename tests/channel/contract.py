"""The levels of conf/channel and variants of them, to hold against the contract of channels."""

from collections.abc import Callable

import torch
from torch import Tensor

from marl_clean.channel.base import Channel
from marl_clean.config.levels import rooms
from marl_clean.testing._levels import maker

LEVELS = rooms()["channel"]
Make = Callable[[tuple[int, ...]], list[Channel]]


def channel(level: str, dims: tuple[int, ...], **changes) -> Channel:
    return maker("channel", level, changes)(message_dims=dims)


def seeds(*batch: int, n_agents: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(2**32, (*batch, n_agents), generator=generator)
