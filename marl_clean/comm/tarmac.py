"""TarMAC: messages carry a signature, and receivers look for what they need."""

from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders, Width, attend, outgoing
from marl_clean.settings import LayerWidth, PositiveInt


@final
class TarMac(Comm):
    """Send a signature and a value; receivers weigh values by how signatures meet their query.

        k_j = W_k h_j,  v_j = W_v h_j    sent;    q_i = W_q h_i    kept
        a_ij = softmax over live edges of q_i . k_j / sqrt(d_key),    c_i = sum over j of a_ij v_j
        each round: h'_i = tanh(W [h_i, c_i])

    A robot without live edge has c_i = 0 exactly. Rounds share their weights.

    Source: arXiv 1810.11187, where a robot hears itself too: `self_included`.

    Args:
        in_features: length of the encoder's features.
        message_dim: floats in a value.
        key_dim: floats in a signature, which is sent and paid for too.
        rounds: messages a step; each is paid for.
        self_included: a robot also attends to what it sends itself, at no cost.
        detach: a receiver's loss does not reach the sender's features.
    """

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        key_dim: LayerWidth,
        rounds: PositiveInt,
        self_included: bool,
        detach: bool,
    ) -> None:
        super().__init__()
        self.self_included, self.detach = self_included, detach
        self.scale = key_dim**-0.5
        self.message = nn.Linear(in_features, key_dim + message_dim)
        self.query = nn.Linear(in_features, key_dim)
        self.join = nn.Linear(in_features + message_dim, in_features)
        self.message_dims, self.out_features = (key_dim + message_dim,) * rounds, in_features

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return self.message(outgoing(state, self.detach))

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent feature"]:
        own = self.message(state) if self.self_included else None
        sum_of_values, _ = attend(self.query(state), heard, live, self.scale, own)
        return self.join(torch.cat([state, sum_of_values], dim=-1)).tanh()
