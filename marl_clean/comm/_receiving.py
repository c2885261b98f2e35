"""What receivers make of messages: sums, the nearest, attention, over live edges alone."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from marl_clean.comm._live_edges import meet_live, weigh_live


def sum_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum of its live neighbours' values; 0 without any."""
    return weigh_live(adjacency.to(value.dtype), value, adjacency)


def sum_live_pairs(
    value: Float[Tensor, "*batch agent other width"],
    live: Bool[Tensor, "*batch agent other"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum over its live edges of value_ij; 0 without any."""
    return torch.where(live.unsqueeze(-1), value, 0.0).sum(-2)


def nearest_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
    distance_rank: Int[Tensor, "*batch agent agent"],
    slots: int,
) -> Float[Tensor, "*batch agent joined"]:
    """Return for each robot its live neighbours' values side by side, nearest first.

    There are `slots` of them; one without a robot holds zeros.
    """
    other, taken = _nearest(adjacency, distance_rank, slots)
    index = other.flatten(-2).unsqueeze(-1)
    gathered = value.gather(-2, index.expand(*index.shape[:-1], value.shape[-1]))
    return _in_slots(gathered.unflatten(-2, other.shape[-2:]), taken, slots)


def nearest_live_pairs(
    value: Float[Tensor, "*batch agent other width"],
    live: Bool[Tensor, "*batch agent other"],
    distance_rank: Int[Tensor, "*batch agent other"],
    slots: int,
) -> Float[Tensor, "*batch agent joined"]:
    """Return what `nearest_live` does, of values value_ij that differ between hearers."""
    other, taken = _nearest(live, distance_rank, slots)
    index = other.unsqueeze(-1).expand(*other.shape, value.shape[-1])
    return _in_slots(value.gather(-2, index), taken, slots)


def _nearest(live: Tensor, distance_rank: Tensor, slots: int) -> tuple[Tensor, Tensor]:
    """The nearest over live edges, `[*B, n, at most slots]`, and which of them there are."""
    agents = live.shape[-1]
    live_rank = torch.where(live, distance_rank, torch.full_like(distance_rank, agents))
    rank, other = live_rank.topk(min(slots, agents), dim=-1, largest=False)
    return other, rank < agents


def _in_slots(value: Tensor, taken: Tensor, slots: int) -> Tensor:
    """The values side by side, zeros in slots that are not taken."""
    heard = torch.where(taken.unsqueeze(-1), value, 0.0).flatten(-2)
    return functional.pad(heard, (0, (slots - value.shape[-2]) * value.shape[-1]))


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
    place: Float[Tensor, "*batch agent other key_and_value"] | None = None,
) -> tuple[Float[Tensor, "*batch agent value"], Float[Tensor, "*batch agent other"]]:
    """Return what each robot makes of its live neighbours' values by their keys: c and a.

        a_ij = softmax over live j of scale q_i . k_j,    c_i = sum over j of a_ij v_j

    A message is [key, value]. `own`: what a robot would have sent itself; then j = i is live too.
    `place`: what is added to key and value of each j as i hears them, 0 over edges that are not
    live. Without any live j, c_i is exactly 0.
    """
    width = query.shape[-1]
    live = adjacency
    score = scale * meet_live(query, message[..., :width], live)
    if place is not None:
        score = score + scale * (query.unsqueeze(-2) * place[..., :width]).sum(-1)
    if own is not None:  # beside the others, rather than among them
        of_itself = scale * (own[..., :width] * query).sum(-1, keepdim=True)
        score = torch.cat([score, of_itself], dim=-1)
        live = functional.pad(adjacency, (0, 1), value=True)
    weight = masked_softmax(score, live)
    others = weight[..., : adjacency.shape[-1]]
    summed = weigh_live(others, message[..., width:], adjacency)
    if place is not None:
        summed = summed + (others.unsqueeze(-1) * place[..., width:]).sum(-2)
    if own is None:
        return summed, others
    itself = weight[..., -1:]
    return summed + itself * own[..., width:], others + torch.diag_embed(itself.squeeze(-1))
