"""Graph attention with additive scores, over edges that gates open and shut."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from marl_clean.comm._live_edges import weigh_live

FARTHEST = 20.0  # how much a shut edge's score may exceed the open ones', so that exp is finite


class GraphAttention(nn.Module):
    """Attend to oneself and to others, each by its gate, by additive scores.

        y_j = W x_j,    y_ij = y_j + P e_ij,    s_ij = leaky_relu(p . y_i + q . y_ij)    of a head
        a_ij = g_ij exp(s_ij) / (exp(s_ii) + sum over live edges of g_ik exp(s_ik))
        c_i = a_ii y_i + sum over live edges of a_ij y_ij + b
        heads side by side, or `mean` over them

    g_ij is 1 without gates, and P e_ij is left out without places. A gate that is 0 has a gradient.
    Source: arXiv 1710.10903; gates: Niu et al., AAMAS 2021.
    """

    def __init__(self, before: int, after: int, heads: int, mean: bool) -> None:
        super().__init__()
        self.heads, self.mean = heads, mean
        self.project = nn.Linear(before, heads * after, bias=False)
        self.hearer = nn.Parameter(torch.empty(heads, 1, after))
        self.sender = nn.Parameter(torch.empty(heads, 1, after))
        self.bias = nn.Parameter(torch.zeros(after if mean else heads * after))
        gain = nn.init.calculate_gain("relu")
        for weight in (self.project.weight, self.hearer, self.sender):
            nn.init.xavier_normal_(weight, gain)

    def forward(
        self,
        own: Float[Tensor, "*batch agent before"],
        heard: Float[Tensor, "*batch agent before"],
        live: Bool[Tensor, "*batch agent other"],
        gate: Float[Tensor, "*batch agent other"] | None = None,
        place: Float[Tensor, "*batch agent other place"] | None = None,
    ) -> tuple[Float[Tensor, "*batch agent after"], Float[Tensor, "*batch head agent other"]]:
        """Return c and a: `own` is what a robot would have said itself; `place` is P e_ij."""
        mine, theirs = self._by_head(self.project(own)), self._by_head(self.project(heard))
        every = live.unsqueeze(-3).expand(*live.shape[:-2], self.heads, *live.shape[-2:])
        opened = every.to(mine.dtype) if gate is None else gate.unsqueeze(-3) * every
        asks = (self.hearer * mine).sum(-1, keepdim=True)
        score = torch.where(every, (self.sender * theirs).sum(-1).unsqueeze(-2), 0.0)
        placed = None if place is None else self._pairs_by_head(place)
        if placed is not None:
            score = score + (self.sender.unsqueeze(-2) * placed).sum(-1)
        score = functional.leaky_relu(asks + score, 0.2)
        itself = asks + (self.sender * mine).sum(-1, keepdim=True)
        weight, alone = _shares(score, functional.leaky_relu(itself, 0.2), opened, every)
        summed = weigh_live(weight, theirs, every) + alone * mine
        if placed is not None:
            summed = summed + (weight.unsqueeze(-1) * placed).sum(-2)
        summed = summed.mean(-3) if self.mean else summed.transpose(-2, -3).flatten(-2)
        return summed + self.bias, weight + torch.diag_embed(alone.squeeze(-1))

    def _by_head(self, value: Tensor) -> Tensor:
        return value.unflatten(-1, (self.heads, -1)).transpose(-2, -3)

    def _pairs_by_head(self, value: Tensor) -> Tensor:
        return value.unflatten(-1, (self.heads, -1)).movedim(-2, -4)


def _shares(score: Tensor, itself: Tensor, opened: Tensor, live: Tensor) -> tuple[Tensor, Tensor]:
    """What each other and the robot itself weigh: softmax over what is open and itself."""
    lowest = torch.finfo(score.dtype).min
    open_scores = torch.where(live & (opened > 0), score, lowest)
    total = torch.cat([open_scores, itself], dim=-1).logsumexp(-1, keepdim=True)
    strength = torch.where(live, (score - total).clamp(max=FARTHEST), lowest).exp()
    weight, alone = opened * strength, (itself - total).exp()
    whole = weight.sum(-1, keepdim=True) + alone
    return weight / whole, alone / whole
