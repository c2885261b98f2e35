"""The paper's approach 2: robots in contact share a learnt vector, their plan (§3.4, figure 4)."""

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Width, dense, nearest_live, sum_live
from marl_clean.settings import PositiveInt


class Plan(Comm):
    """Join each robot's features with the plans of the robots it is in contact with.

        m_j = message(h_j)                        the plan robot j sends
        r_j = relu(W_r m_j)                       a received plan, through its own block
        ordered: c_i = [r_j of i's nearest live edge, of the next, ..., 0 for an empty place]
        sum:     c_i = sum over live edges of r_j
        h'_i = relu(W [relu(W_o h_i), c_i])

    Source: paper §3.4, approach 2, and figure 4; more than one neighbour is our extension. A dead
    edge is masked, not multiplied by 0, so even NaN does not cross it, and no gradient.

    Args:
        in_features: length of the encoder's features.
        message_dim: floats in a message.
        hidden: width of the own block and of the joined layer.
        received: width of the block each received message goes through.
        combine: `ordered` takes up to `max_neighbours`, nearest first; `sum` any number.
        max_neighbours: places of `ordered`; further neighbours are not heard.
    """

    def __init__(
        self,
        in_features: Width,
        message_dim: PositiveInt,
        hidden: PositiveInt,
        received: PositiveInt,
        combine: Literal["ordered", "sum"],
        max_neighbours: PositiveInt,
    ) -> None:
        super().__init__()
        self.places = max_neighbours if combine == "ordered" else None
        self.message = nn.Sequential(
            nn.Linear(in_features, hidden), nn.ReLU(), nn.Linear(hidden, message_dim)
        )
        self.received = dense(message_dim, received)
        self.own = dense(in_features, hidden)
        self.join = dense(hidden + received * (self.places or 1), hidden)
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
        distance_rank: Int[Tensor, "*batch agent other"],
        round_index: int,
    ) -> Float[Tensor, "*batch agent joined"]:
        received = self.received(heard)
        if self.places is None:
            neighbours = sum_live(received, live)
        else:
            neighbours = nearest_live(received, live, distance_rank, self.places)
        return self.join(torch.cat([self.own(state), neighbours], dim=-1))
