"""TarMAC: messages carry a signature, and receivers look for what they need."""

from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Hearing, Senders, Width, attend, outgoing, place_of
from marl_clean.settings import LayerWidth, PositiveInt


@final
class TarMac(Comm):
    """Send a signature and a value; receivers weigh values by how signatures meet their query.

        k_j = W_k h_j,  v_j = W_v h_j    sent;    q_i = W_q h_i    kept
        k_ij = k_j + U_k e_ij,  v_ij = v_j + U_v e_ij    as i hears them
        a_ij = softmax over live edges of q_i . k_ij / sqrt(d_key),    c_i = sum over j of a_ij v_ij
        each round: h'_i = tanh(W [h_i, c_i])

    e_ij says where j is, with `places`; without, k_ij = k_j and v_ij = v_j. A robot without live
    edge has c_i = 0 exactly. Rounds share their weights.

    Source: arXiv 1810.11187, where a robot hears itself too: `self_included`.

    Args:
        in_features: length of the encoder's features.
        message_dim: floats in a value.
        key_dim: floats in a signature, which is sent and paid for too.
        rounds: messages a step; each is paid for.
        self_included: a robot also attends to what it sends itself, at no cost.
        detach: a receiver's loss does not reach the sender's features.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        key_dim: LayerWidth,
        rounds: PositiveInt,
        self_included: bool,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        self.self_included, self.detach = self_included, detach
        self.scale = key_dim**-0.5
        self.message = nn.Linear(in_features, key_dim + message_dim)
        self.query = nn.Linear(in_features, key_dim)
        self.join = nn.Linear(in_features + message_dim, in_features)
        self.message_dims = (key_dim + message_dim,) * rounds
        self.place = hearing.place_layer(key_dim + message_dim)
        self.give(in_features, in_features, hearing)

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
        place = None if self.place is None else self.place(place_of(senders))
        sum_of_values, _ = attend(self.query(state), heard, live, self.scale, own, place)
        return self.join(torch.cat([state, sum_of_values], dim=-1)).tanh()
