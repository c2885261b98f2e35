"""What schemes share whose networks send nothing."""

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.comm.base import Comm, Senders, Width


class Quiet(Comm):
    """Return the features unchanged; messages are empty."""

    def __init__(self, in_features: Width) -> None:
        super().__init__()
        self.message_dims, self.out_features = (), in_features

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent 0"]:
        return state[..., :0]

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent feature"]:
        return state
