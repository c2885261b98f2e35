"""A decision between 0 and 1 that learns."""

import torch
from jaxtyping import Float
from torch import Tensor


def open_or_shut(
    logit: Float[Tensor, "*batch"], temperature: float, learning: bool
) -> Float[Tensor, "*batch"]:
    """Decide between 0 and 1, and learn as if by their probability (straight-through Gumbel).

        learning: g = 1 if l + z > 0 else 0, z logistic;    dg/dl = that of sigmoid((l + z) / t)
        used:     g = 1 if l > 0 else 0

    The difference of two Gumbel numbers is logistic. Source: arXiv 1611.01144, with two classes.
    """
    if not learning:
        return (logit > 0).to(logit.dtype)
    uniform = torch.rand_like(logit).clamp(1e-6, 1 - 1e-6)
    noisy = logit + uniform.log() - (1 - uniform).log()
    soft = (noisy / temperature).sigmoid()
    return soft + ((noisy > 0).to(logit.dtype) - soft).detach()
