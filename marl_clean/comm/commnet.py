"""CommNet: robots hear the mean of the others' hidden states, round after round."""

from typing import Literal, final

from jaxtyping import Bool
from torch import Tensor

from marl_clean.comm._hidden_states import HiddenStates, all_others
from marl_clean.comm.base import Hearing, Width
from marl_clean.settings import LayerWidth, PositiveInt


@final
class CommNet(HiddenStates):
    """Hear the mean of the others' hidden states, in rounds.

        x_i = W_x feature_i,    h_i = tanh(x_i)
        each round: h'_i = tanh(x_i + F h_i + C m_i)
        m_i = sum over live edges of [h_j, e_ij] / d_i
        live:   d_i = the number of i's live edges, m_i = 0 without any       (CommNet)
        others: d_i = n - 1, all other robots, so that silence dilutes        (IC3Net)

    F and C are each round's own. The hidden state is the message; e_ij says where j is, with
    `places`, and is left out without. With `others` the result depends on how many robots there
    are, also out of reach.

    Source: arXiv 1605.07736; `others`: arXiv 1812.09755.

    Args:
        in_features: length of the encoder's features.
        hidden: width of the hidden state, and so floats in a message.
        rounds: messages a step; each is paid for.
        divisor: what the sum over live edges is divided by.
        detach: a receiver's loss does not reach the sender's hidden state.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        hidden: LayerWidth,
        rounds: PositiveInt,
        divisor: Literal["live", "others"],
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__(in_features, hidden, rounds, detach, hearing)
        self.dilutes = divisor == "others"

    def divisor(self, live: Bool[Tensor, "*batch agent other"]) -> Tensor | int:
        return all_others(live) if self.dilutes else live.sum(-1, keepdim=True).clamp(min=1)
