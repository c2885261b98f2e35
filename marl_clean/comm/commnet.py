"""CommNet: robots hear the mean of the others' hidden states, round after round."""

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Width, outgoing, sum_live
from marl_clean.settings import PositiveInt

State = tuple[Tensor, ...]  # W_x feature, the hidden state, and what a scheme built on it adds


class CommNet(Comm):
    """Hear the mean of the others' hidden states, in rounds.

        x_i = W_x feature_i,    h_i = tanh(x_i)
        each round: h'_i = tanh(x_i + F h_i + C m_i),    m_i = sum over live edges of h_j / d_i
        live:   d_i = the number of i's live edges, m_i = 0 without any       (CommNet)
        others: d_i = n - 1, all other robots, so that silence dilutes        (IC3Net)

    F and C are each round's own. The hidden state is the message. With `others` the result
    depends on how many robots there are, also out of reach.

    Source: arXiv 1605.07736; `others`: arXiv 1812.09755.

    Args:
        in_features: length of the encoder's features.
        hidden: width of the hidden state, and so floats in a message.
        rounds: messages a step; each is paid for.
        divisor: what the sum over live edges is divided by.
        detach: a receiver's loss does not reach the sender's hidden state.
    """

    def __init__(
        self,
        in_features: Width,
        hidden: PositiveInt,
        rounds: PositiveInt,
        divisor: Literal["live", "others"],
        detach: bool,
    ) -> None:
        super().__init__()
        self.dilutes = divisor == "others"
        self.detach = detach
        self.skip = nn.Linear(in_features, hidden)
        self.own = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(rounds))
        self.heard = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(rounds))
        self.message_dims, self.out_features = (hidden,) * rounds, hidden

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> State:
        skip = self.skip(feature)
        return skip, skip.tanh()

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent hidden"]:
        return outgoing(state[1], self.detach)

    def listen(
        self,
        state: State,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        distance_rank: Int[Tensor, "*batch agent other"],
        round_index: int,
    ) -> State:
        skip, hidden, *further = state
        own, others = self.own[round_index], self.heard[round_index]
        return skip, torch.tanh(skip + own(hidden) + others(self.mean(heard, live))), *further

    def end(self, state: State) -> Float[Tensor, "*batch agent hidden"]:
        return state[1]

    def mean(
        self,
        hidden: Float[Tensor, "*batch agent hidden"],
        adjacency: Bool[Tensor, "*batch agent agent"],
    ) -> Float[Tensor, "*batch agent hidden"]:
        """Return the sum over live edges, divided as asked for; 0 without any."""
        total = sum_live(hidden, adjacency)
        if self.dilutes:
            return total / max(1, adjacency.shape[-1] - 1)
        return total / adjacency.sum(-1, keepdim=True).clamp(min=1)
