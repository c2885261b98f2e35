"""The silent twin of `plan`: a control for what its parameters alone bring."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.comm.plan import Plan


class Zeroed(Plan):
    """The parameters of `plan`, fed zeros in the place of what is received; nothing crosses.

        h'_i = relu(W [relu(W_o h_i), 0])

    So `plan` against `zeroed` tells what messages bring, and `zeroed` against `none` what a
    larger network brings. Settings are those of `marl_clean.comm.plan.Plan`. Messages are still
    computed and masked, so a step takes as long and every weight has a gradient, which is 0.

    Source: our control.
    """

    rounds = 0

    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
    ) -> tuple[
        Float[Tensor, "*batch agent joined"],
        Float[Tensor, "*batch agent 0"],
        Float[Tensor, "*batch agent 1"],
    ]:
        """Return the joined features, nothing sent, and 0 bits."""
        nobody = torch.zeros_like(adjacency)
        joined, message, bits = super().forward(feature, nobody, distance_rank)
        return joined, message[..., :0], bits
