"""TarMAC: robots say what their message is about, and hearers look for what they need."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Width, attend, bits_sent, outgoing
from marl_clean.settings import PositiveInt


class TarMac(Comm):
    """Send a signature and a value; hearers weigh values by how signatures meet their query.

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
        message_dim: PositiveInt,
        key_dim: PositiveInt,
        rounds: PositiveInt,
        self_included: bool,
        detach: bool,
    ) -> None:
        super().__init__()
        self.rounds, self.self_included, self.detach = rounds, self_included, detach
        self.scale = key_dim**-0.5
        self.message = nn.Linear(in_features, key_dim + message_dim)
        self.query = nn.Linear(in_features, key_dim)
        self.join = nn.Linear(in_features + message_dim, in_features)
        self.out_features = in_features

    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
    ) -> tuple[
        Float[Tensor, "*batch agent joined"],
        Float[Tensor, "*batch agent message"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return the last features, signatures and values sent, and 32 bits a float and edge."""
        sent = []
        for _ in range(self.rounds):
            sent.append(self.message(outgoing(feature, self.detach)))
            own = self.message(feature) if self.self_included else None
            heard = attend(self.query(feature), sent[-1], adjacency, self.scale, own)
            feature = self.join(torch.cat([feature, heard], dim=-1)).tanh()
        message = torch.cat(sent, dim=-1)
        return feature, message, bits_sent(message.shape[-1], adjacency, feature.dtype)
