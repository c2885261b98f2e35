"""DGN: attention over neighbours and self in rounds, whose features all reach the Q head."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Width, attend, dense, outgoing
from marl_clean.settings import PositiveInt


class Dgn(Comm):
    """Attend to neighbours and oneself with several heads, and keep the features of all rounds.

        head m: a_ij = softmax over i and its live edges of q_i . k_j / sqrt(d)
                c_i^m = sum over j of a_ij v_j,    q, k, v = W_q^m h_i, W_k^m h_j, W_v^m h_j
        each round: h'_i = relu(W [c_i^1, ..., c_i^M])
        result: [h^0, h^1, ..., h^K], h^0 the encoder's

    A robot sends its features h, and who hears them makes keys and values of them; each round
    has weights of its own.

    Source: arXiv 1810.09202, without its pull of attention towards the next step's.

    Args:
        in_features: length of the encoder's features.
        hidden: width of each round's features; a later round sends those.
        heads: attention heads M.
        head_dim: length d of a head's query, key and value.
        rounds: messages a step; each is paid for.
        detach: a receiver's loss does not reach the sender's features.
    """

    def __init__(
        self,
        in_features: Width,
        hidden: PositiveInt,
        heads: PositiveInt,
        head_dim: PositiveInt,
        rounds: PositiveInt,
        detach: bool,
    ) -> None:
        super().__init__()
        self.heads, self.detach = heads, detach
        self.scale = head_dim**-0.5
        widths, joined = [in_features] + [hidden] * (rounds - 1), heads * head_dim
        self.query = nn.ModuleList(nn.Linear(width, joined) for width in widths)
        self.key_and_value = nn.ModuleList(nn.Linear(width, 2 * joined) for width in widths)
        self.join = nn.ModuleList(dense(joined, hidden) for _ in widths)
        self.message_dims, self.out_features = widths, in_features + rounds * hidden

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> list[Tensor]:
        return [feature]

    def speak(self, state: list[Tensor], turn: int) -> Float[Tensor, "*batch agent message"]:
        return outgoing(state[-1], self.detach)

    def listen(
        self,
        state: list[Tensor],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
        turn: int,
    ) -> list[Tensor]:
        query, key_and_value = self.query[turn], self.key_and_value[turn]
        every_head = live.unsqueeze(-3).expand(*live.shape[:-2], self.heads, *live.shape[-2:])
        summed = attend(
            self.by_head(query(state[-1])),
            self.by_head(key_and_value(heard)),
            every_head,
            self.scale,
            own=self.by_head(key_and_value(state[-1])),
        )
        return [*state, self.join[turn](summed.transpose(-2, -3).flatten(-2))]

    def end(self, state: list[Tensor]) -> Float[Tensor, "*batch agent joined"]:
        return torch.cat(state, dim=-1)

    def by_head(
        self, value: Float[Tensor, "*batch agent joined"]
    ) -> Float[Tensor, "*batch head agent part"]:
        """Return one part of the vector for each head, as a batch of heads."""
        return value.unflatten(-1, (self.heads, -1)).transpose(-2, -3)
