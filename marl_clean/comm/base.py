"""What every communication scheme takes and gives."""

from abc import ABC, abstractmethod

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

Width = int
"""Length of a feature vector; handed over by the network's builder, so never a config key."""

BITS_PER_FLOAT = 32


class Comm(nn.Module, ABC):
    """Turn features of robots and who may talk to whom into features that know of each other.

    A robot sends its message to each of its live edges, so its bits in a step are
    32 x length of the message x its live edges, whether or not the receiver makes use of it.
    The messages of several rounds stand side by side: every round costs.
    Results depend on live edges only, and not on how the robots are numbered. A dead edge is
    masked by `torch.where` and never multiplied by 0, so not even NaN crosses it, in either
    direction of the arithmetic.
    """

    out_features: int
    rounds: int  # edges that what a robot knows crosses within one step

    @abstractmethod
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
        """Return the new features, the messages sent, and what sending them cost in bits.

        `distance_rank` [i, j] is the rank of j among the others seen from i: 0 is i itself, 1
        its nearest.
        """


def bits_sent(
    numbers: int, adjacency: Bool[Tensor, "*batch agent agent"], dtype: torch.dtype
) -> Float[Tensor, "*batch agent 1"]:
    """Return what each robot's message of this many floats costs: 32 bits each, to every edge."""
    return BITS_PER_FLOAT * numbers * adjacency.sum(-1, keepdim=True).to(dtype)


def outgoing(feature: Tensor, detach: bool) -> Tensor:
    """Return the features that messages are made of.

    Detached, a receiver's loss does not reach the sender's features; the weights that make the
    message of them, which all robots share, still learn.
    """
    return feature.detach() if detach else feature


def dense(before: int, after: int) -> nn.Sequential:
    """Return a fully connected layer and its ReLU."""
    return nn.Sequential(nn.Linear(before, after), nn.ReLU())


def spread_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
) -> Float[Tensor, "*batch agent agent width"]:
    """Return [i, j] = the value of j where i has a live edge to it, else 0."""
    return torch.where(adjacency.unsqueeze(-1), value.unsqueeze(-3), 0.0)


def sum_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum of its live neighbours' values; 0 without any."""
    return spread_live(value, adjacency).sum(-2)


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


def masked_softmax(
    score: Float[Tensor, "*batch agent other"], live: Bool[Tensor, "*batch agent other"]
) -> Float[Tensor, "*batch agent other"]:
    """Return softmax over the live ones, 0 elsewhere; a row without any is all 0."""
    lowest = torch.finfo(score.dtype).min  # not -inf: a row of those is NaN, and so its gradient
    return torch.where(live, torch.where(live, score, lowest).softmax(-1), 0.0)


def attend(
    query: Float[Tensor, "*batch agent key"],
    message: Float[Tensor, "*batch agent key_and_value"],
    adjacency: Bool[Tensor, "*batch agent agent"],
    scale: float,
    own: Float[Tensor, "*batch agent key_and_value"] | None = None,
) -> Float[Tensor, "*batch agent value"]:
    """Return what each robot makes of its live neighbours' values by their keys.

        a_ij = softmax over live j of scale q_i . k_j,    c_i = sum over j of a_ij v_j

    A message is [key, value]. `own`: what a robot would have sent itself; then j = i is live too.
    Without any live j, c_i is exactly 0.
    """
    heard = spread_live(message, adjacency)
    if own is not None:
        itself = torch.eye(adjacency.shape[-1], dtype=torch.bool, device=adjacency.device)
        heard = torch.where(itself.unsqueeze(-1), own.unsqueeze(-2), heard)
        adjacency = adjacency | itself
    width = query.shape[-1]
    score = scale * (query.unsqueeze(-2) * heard[..., :width]).sum(-1)
    weight = masked_softmax(score, adjacency)
    return (weight.unsqueeze(-1) * heard[..., width:]).sum(-2)
