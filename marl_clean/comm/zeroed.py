"""The silent twin of `plan`: a control for what its parameters alone bring."""

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.comm.plan import Plan


class Zeroed(Plan):
    """The parameters of `plan`, fed zeros in the place of what is received; nothing crosses.

        h'_i = relu(W [relu(W_o h_i), 0])

    So `plan` against `zeroed` shows what messages bring, and `zeroed` against `none` what a
    larger network brings. Settings are those of `marl_clean.comm.plan.Plan`. Messages are still
    made and masked, so a step takes as long and every weight has a gradient, which is 0.

    Source: our control.
    """

    @property
    def rounds(self) -> int:
        return 0

    def end(
        self, state: Float[Tensor, "*batch agent feature"]
    ) -> Float[Tensor, "*batch agent joined"]:
        rank = torch.zeros(
            *state.shape[:-1], state.shape[-2], dtype=torch.int64, device=state.device
        )
        return self.listen(state, self.speak(state, 0), rank > 0, rank, 0)
