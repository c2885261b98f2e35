"""Robots hear, number by number, the largest of what their neighbours say."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders, Width
from marl_clean.settings import PositiveInt


class Loudest(Comm):
    """Hear the largest of all messages in each number, and nothing without a live edge.

        m_j = W_m h_j,    c_i = max over live edges of m_j, 0 without any
        h'_i = relu(W [h_i, c_i])

    A dead edge is masked before the maximum, so nothing crosses it, and no gradient.

    Args:
        in_features: length of the encoder's features.
        message_dim: floats in a message.
        hidden: width of the joined layer.
    """

    def __init__(self, in_features: Width, message_dim: PositiveInt, hidden: PositiveInt) -> None:
        super().__init__()
        self.message = nn.Linear(in_features, message_dim)
        self.join = nn.Sequential(nn.Linear(in_features + message_dim, hidden), nn.ReLU())
        self.message_dims, self.out_features = (message_dim,), hidden

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return self.message(state)

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent joined"]:
        lowest = torch.finfo(heard.dtype).min
        spread = torch.where(live.unsqueeze(-1), heard.unsqueeze(-3), lowest)
        loudest = torch.where(live.any(-1, keepdim=True), spread.amax(-2), 0.0)
        return self.join(torch.cat([state, loudest], dim=-1))
