"""Losses that several learners share."""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

DISTANCES = {
    "smooth_l1": functional.smooth_l1_loss,
    "l2": functional.mse_loss,
    "l1": functional.l1_loss,
}
MARGIN = 0.8  # by which a planner's action shall be worth more than all others, as in the source


def margin_loss(
    value: Float[Tensor, "*batch action"], demonstrated: Int[Tensor, "*batch"]
) -> Float[Tensor, ""]:
    """Return the large-margin loss of action values against a planner's actions.

        loss = max_a (Q(o, a) + 0.8 [a != a_planner]) - Q(o, a_planner), mean over the batch

    0 where no planner acted (-1), or where its action is masked. Source: DQfD, arXiv 1704.03732.
    """
    action = demonstrated.clamp(min=0).unsqueeze(-1)
    planned = value.gather(-1, action)
    rivals = (value + MARGIN).scatter(-1, action, planned)
    return _mean_where_demonstrated(rivals.amax(-1) - planned.squeeze(-1), value, demonstrated)


def cross_entropy(
    logits: Float[Tensor, "*batch action"], demonstrated: Int[Tensor, "*batch"]
) -> Float[Tensor, ""]:
    """Return -log pi(a_planner | o), mean over the batch.

    0 where no planner acted (-1), or where its action is masked.
    """
    action = demonstrated.clamp(min=0).unsqueeze(-1)
    surprise = -logits.log_softmax(-1).gather(-1, action).squeeze(-1)
    return _mean_where_demonstrated(surprise, logits, demonstrated)


def _mean_where_demonstrated(
    loss: Float[Tensor, "*batch"],
    out: Float[Tensor, "*batch action"],
    demonstrated: Int[Tensor, "*batch"],
) -> Float[Tensor, ""]:
    action = demonstrated.clamp(min=0).unsqueeze(-1)
    planned = out.detach().gather(-1, action).squeeze(-1)
    shown = (demonstrated >= 0) & (planned > torch.finfo(out.dtype).min)
    return torch.where(shown, loss, 0.0).mean()
