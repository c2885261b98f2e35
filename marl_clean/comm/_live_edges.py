"""Products over live edges: by matrices, and yet nothing crosses a dead one, not even NaN.

Spreading values over all pairs of robots and masking them is simpler; it moves n x n x width
numbers. A product by matrices moves n x n + n x width, but 0 x NaN is NaN. So a value that is not
finite is left out of the product, and the row of each robot with a live edge to it is set to NaN.
The two products are each other's gradients, which so keep to live edges as well.
"""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd import Function


def weigh_live(
    weight: Float[Tensor, "*batch agent other"],
    value: Float[Tensor, "*batch other width"],
    live: Bool[Tensor, "*batch agent other"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum over its live edges of weight_ij value_j; 0 without any.

    A value that is not finite makes all of the row NaN of each robot that has a live edge to it.
    """
    return _Weigh.apply(weight, value, live)


def meet_live(
    query: Float[Tensor, "*batch agent width"],
    key: Float[Tensor, "*batch other width"],
    live: Bool[Tensor, "*batch agent other"],
) -> Float[Tensor, "*batch agent other"]:
    """Return query_i . key_j over live edges, 0 elsewhere."""
    return _Meet.apply(query, key, live)


class _Weigh(Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(weight: Tensor, value: Tensor, live: Tensor) -> Tensor:
        nan_or_zero = (0 * value.sum(-1)).unsqueeze(-2)  # NaN for a robot that is not finite
        poison = torch.where(live, nan_or_zero, 0.0).sum(-1, keepdim=True)
        return torch.where(live, weight, 0.0) @ value.nan_to_num(0.0, 0.0, 0.0) + poison

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor, Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        weight, value, live = ctx.saved_tensors
        of_weight, of_value, _ = ctx.needs_input_grad
        return (
            meet_live(grad, value, live) if of_weight else None,
            weigh_live(weight.mT, grad, live.mT) if of_value else None,
            None,
        )


class _Meet(Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(query: Tensor, key: Tensor, live: Tensor) -> Tensor:
        return torch.where(live, query @ key.mT, 0.0)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor, Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        query, key, live = ctx.saved_tensors
        of_query, of_key, _ = ctx.needs_input_grad
        return (
            weigh_live(grad, key, live) if of_query else None,
            weigh_live(grad.mT, query, live.mT) if of_key else None,
            None,
        )
