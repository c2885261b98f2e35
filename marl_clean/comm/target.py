"""An engineered message: the cell that the sender has to clean next."""

from typing import ClassVar, Literal, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._joining import Joining
from marl_clean.comm._senders import CELLS
from marl_clean.comm.base import Hearing, Scene, Senders, Width
from marl_clean.settings import LayerWidth, PositiveInt


@final
class Target(Joining):
    """Robots in contact tell each other which cell they walk to.

        m_j = (row, col) from j to its target / 10, and whether it has one / 10
        r_ij = relu(W_r [m_j, e_ij])              a received message, through its own block
        ordered: c_i = [r_ij of i's nearest live edge, of the next, ..., 0 for an empty slot]
        sum:     c_i = sum over live edges of r_ij
        h'_i = relu(W [relu(W_o h_i), c_i])

    e_ij says where j is, with `places`; without it a hearer does not know where the target is.
    The target is the nearest cell that the sender's map does not know or knows not to be cleaned,
    see `marl_clean.env.targets.Targets`. The messages are the env's, so that nothing of them is
    learnt, only how they are heard; each number is a count of cells, 8 bits.

    Source: ours; the message of a market-based coordinator. Figure 4 of the paper for the layers.

    Args:
        in_features: length of the encoder's features.
        hidden: width of the own block and of the joined layer.
        received: width of the block each received message goes through.
        combine: `ordered` takes up to `max_neighbours`, nearest first; `sum` any number.
        max_neighbours: slots of `ordered`; further neighbours are not heard.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    reads: ClassVar[str] = "target"
    reads_numbers: ClassVar[int] = 3
    fits: ClassVar[dict[str, list[str]]] = {"env": ["cleaning"]}
    engineered: ClassVar[bool] = True
    bits_per_number = 8

    def __init__(
        self,
        in_features: Width,
        hidden: LayerWidth,
        received: LayerWidth,
        combine: Literal["ordered", "sum"],
        max_neighbours: PositiveInt,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__(
            nn.Identity(),
            in_features,
            self.reads_numbers,
            hidden,
            received,
            combine,
            max_neighbours,
            hearing,
        )

    def look(
        self, feature: Float[Tensor, "*batch agent feature"], scene: Scene
    ) -> Float[Tensor, "*batch agent feature_and_target"]:
        assert scene.read is not None
        return torch.cat([feature, scene.read.to(feature.dtype) / CELLS], dim=-1)

    def speak(
        self, state: Float[Tensor, "*batch agent feature_and_target"], round_index: int
    ) -> Float[Tensor, "*batch agent 3"]:
        return state[..., -self.reads_numbers :]

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature_and_target"],
        heard: Float[Tensor, "*batch agent 3"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent joined"]:
        feature = state[..., : -self.reads_numbers]
        return super().listen(feature, heard, live, senders, round_index)
