"""The paper's approach 2: robots in contact share a learnt vector, their plan (§3.4, figure 4)."""

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from marl_clean.comm.base import BITS_PER_FLOAT, Comm, Width
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
        self.message_bits = BITS_PER_FLOAT * message_dim
        self.message = nn.Sequential(
            nn.Linear(in_features, hidden), nn.ReLU(), nn.Linear(hidden, message_dim)
        )
        self.received = nn.Sequential(nn.Linear(message_dim, received), nn.ReLU())
        self.own = nn.Sequential(nn.Linear(in_features, hidden), nn.ReLU())
        self.join = nn.Sequential(
            nn.Linear(hidden + received * (self.places or 1), hidden), nn.ReLU()
        )
        self.out_features = hidden

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
        """Return the joined features, the plans sent, and 32 bits a float and live edge."""
        message = self.message(feature)
        received = self.received(message)
        if self.places is None:
            heard = sum_live(received, adjacency)
        else:
            heard = nearest_live(received, adjacency, distance_rank, self.places)
        joined = self.join(torch.cat([self.own(feature), heard], dim=-1))
        bits = self.message_bits * adjacency.sum(-1, keepdim=True).to(feature.dtype)
        return joined, message, bits


def sum_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum of its live neighbours' values; 0 without any."""
    return torch.where(adjacency.unsqueeze(-1), value.unsqueeze(-3), 0.0).sum(-2)


def nearest_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
    distance_rank: Int[Tensor, "*batch agent agent"],
    places: int,
) -> Float[Tensor, "*batch agent joined"]:
    """Return for each robot its live neighbours' values side by side, nearest first.

    There is room for `places` of them; a place without a robot holds zeros.
    """
    agents, width = value.shape[-2:]
    taken = min(places, agents)
    beyond_all = torch.full_like(distance_rank, agents)
    rank, other = torch.where(adjacency, distance_rank, beyond_all).sort(dim=-1)
    rank, other = rank[..., :taken, None], other[..., :taken, None]
    spread = value.unsqueeze(-3).expand(*adjacency.shape, width)
    gathered = spread.gather(-2, other.expand(*other.shape[:-1], width))
    heard = torch.where(rank < agents, gathered, 0.0).flatten(-2)
    return functional.pad(heard, (0, (places - taken) * width))
