"""What schemes share whose robots send their hidden states."""

from abc import abstractmethod

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Hearing, Senders, Width, outgoing, place_of, sum_live

State = tuple[Tensor, ...]  # W_x feature, the hidden state, and what a scheme adds


class HiddenStates(Comm):
    """Send the hidden state in rounds, and hear what `average` makes of the others'.

        x_i = W_x feature_i,    h_i = tanh(x_i)
        each round: h'_i = tanh(x_i + F h_i + C m_i)
        m_i = sum over live edges of [h_j, e_ij] / d_i,    d_i = divisor

    F and C are each round's own. e_ij says where j is, with `places`; it is left out without.
    """

    def __init__(
        self, in_features: Width, hidden: Width, rounds: Width, detach: bool, hearing: Hearing
    ) -> None:
        super().__init__()
        self.detach = detach
        self.skip = nn.Linear(in_features, hidden)
        self.own = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(rounds))
        heard = hidden + hearing.place_numbers
        self.heard = nn.ModuleList(nn.Linear(heard, hidden, bias=False) for _ in range(rounds))
        self.message_dims = (hidden,) * rounds
        self.give(hidden, in_features, hearing)

    @abstractmethod
    def divisor(self, live: Bool[Tensor, "*batch agent other"]) -> Tensor | int:
        """Return what sums over live edges are divided by, `[*B, n, 1]` or one number."""

    def average(
        self,
        hidden: Float[Tensor, "*batch agent hidden"],
        live: Bool[Tensor, "*batch agent other"],
    ) -> Float[Tensor, "*batch agent hidden"]:
        """Return what each robot hears of the hidden states over its live edges."""
        return sum_live(hidden, live) / self.divisor(live)

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
        senders: Senders,
        round_index: int,
    ) -> State:
        skip, hidden, *further = state
        own, others = self.own[round_index], self.heard[round_index]
        mean = self.average(heard, live)
        if self.places:
            place = place_of(senders).sum(-2) / self.divisor(live)
            mean = torch.cat([mean, place], dim=-1)
        return skip, torch.tanh(skip + own(hidden) + others(mean)), *further

    def end(self, state: State) -> Float[Tensor, "*batch agent hidden"]:
        return state[1]


def all_others(live: Bool[Tensor, "*batch agent other"]) -> int:
    """Return the number of all other robots, in reach or not; at least 1."""
    return max(1, live.shape[-1] - 1)
