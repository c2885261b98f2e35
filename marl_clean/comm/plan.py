"""The paper's approach 2: robots in contact share a learnt vector, their plan (§3.4, figure 4)."""

from typing import Literal, final

from marl_clean.comm._joining import Joining, message_layers
from marl_clean.comm.base import Hearing, Width
from marl_clean.settings import LayerWidth, PositiveInt


@final
class Plan(Joining):
    """Join each robot's features with the plans of the robots it is in contact with.

        m_j = message(h_j)                        the plan robot j sends
        r_ij = relu(W_r [m_j, e_ij])              a received plan, through its own block
        ordered: c_i = [r_ij of i's nearest live edge, of the next, ..., 0 for an empty slot]
        sum:     c_i = sum over live edges of r_ij
        h'_i = relu(W [relu(W_o h_i), c_i])

    e_ij says where j is, with `places`; it is left out without.

    Source: paper §3.4, approach 2, and figure 4; more than one neighbour is our extension. A dead
    edge is masked, not multiplied by 0, so even NaN does not cross it, and no gradient.

    Args:
        in_features: length of the encoder's features.
        message_dim: floats in a message.
        hidden: width of the own block and of the joined layer.
        received: width of the block each received message goes through.
        combine: `ordered` takes up to `max_neighbours`, nearest first; `sum` any number.
        max_neighbours: slots of `ordered`; further neighbours are not heard.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
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
