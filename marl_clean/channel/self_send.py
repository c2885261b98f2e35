"""A control: every robot hears itself."""

from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.channel.base import Channel, Step


@final
class SelfSend(Channel):
    """Hear one's own message in the place of others', wherever somebody would be heard.

    The network, its computations and what is paid are those of communication, and nothing is
    transferred: what a policy gains by messages beyond this is what they carry. How many others
    would be heard is lost too, and at most a message is heard, over the edge [i, i].

    Source: our control; CommNet's and others' gains are seldom held against it.
    """

    def carry(
        self,
        message: Float[Tensor, "*batch agent message"],
        edges: Bool[Tensor, "*batch agent other"],
        round_index: int,
        step: Step,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        itself = torch.eye(edges.shape[-1], dtype=torch.bool, device=edges.device)
        return message, itself & edges.any(-1, keepdim=True)
