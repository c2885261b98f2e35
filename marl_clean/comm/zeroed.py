"""`plan` without its message: a control for the effect of its parameters alone."""

from typing import Literal, final

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.comm._joining import Joining, message_layers
from marl_clean.comm.base import Hearing, Senders, Width
from marl_clean.settings import LayerWidth, PositiveInt


@final
class Zeroed(Joining):
    """The parameters of `plan`, fed zeros in the place of what is received; nothing crosses.

        h'_i = relu(W [relu(W_o h_i), 0])

    So `plan` against `zeroed` shows what messages bring, and `zeroed` against `none` what a
    larger network brings. Messages are still made and masked, so a step takes as long and every
    weight has a gradient, which is 0.

    Source: our control.

    Args:
        in_features: length of the encoder's features.
        message_dim, hidden, received, combine, max_neighbours, hearing: as in
            `marl_clean.comm.plan.Plan`.
    """

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        hidden: LayerWidth,
        received: LayerWidth,
        combine: Literal["ordered", "sum"],
        max_neighbours: PositiveInt,
        hearing: Hearing = Hearing(),
    ) -> None:
        message = message_layers(in_features, hidden, message_dim)
        super().__init__(
            message, in_features, message_dim, hidden, received, combine, max_neighbours, hearing
        )

    @property
    def rounds(self) -> int:
        return 0

    def end(
        self, state: Float[Tensor, "*batch agent feature"]
    ) -> Float[Tensor, "*batch agent joined"]:
        rank = torch.zeros(
            *state.shape[:-1], state.shape[-2], dtype=torch.int64, device=state.device
        )
        nobody = Senders(rank, state.new_zeros(*rank.shape, 2))
        return self.listen(state, self.speak(state, 0), rank > 0, nobody, 0)
