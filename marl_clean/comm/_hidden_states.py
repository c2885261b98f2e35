"""What schemes share whose robots send their hidden states."""

from abc import abstractmethod

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders, Width, outgoing, sum_live

State = tuple[Tensor, ...]  # W_x feature, the hidden state, and what a scheme adds


class HiddenStates(Comm):
    """Send the hidden state in rounds, and hear what `average` makes of the others'.

        x_i = W_x feature_i,    h_i = tanh(x_i)
        each round: h'_i = tanh(x_i + F h_i + C m_i),    m_i = average over live edges of h_j

    F and C are each round's own.
    """

    def __init__(self, in_features: Width, hidden: Width, rounds: Width, detach: bool) -> None:
        super().__init__()
        self.detach = detach
        self.skip = nn.Linear(in_features, hidden)
        self.own = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(rounds))
        self.heard = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(rounds))
        self.message_dims, self.out_features = (hidden,) * rounds, hidden

    @abstractmethod
    def average(
        self,
        hidden: Float[Tensor, "*batch agent hidden"],
        live: Bool[Tensor, "*batch agent other"],
    ) -> Float[Tensor, "*batch agent hidden"]:
        """Return what each robot hears of the hidden states over its live edges."""

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
        return skip, torch.tanh(skip + own(hidden) + others(self.average(heard, live))), *further

    def end(self, state: State) -> Float[Tensor, "*batch agent hidden"]:
        return state[1]


def mean_over_all_others(
    hidden: Float[Tensor, "*batch agent hidden"], live: Bool[Tensor, "*batch agent other"]
) -> Float[Tensor, "*batch agent hidden"]:
    """Return the sum over live edges divided by the number of all other robots, in reach or not."""
    return sum_live(hidden, live) / max(1, live.shape[-1] - 1)
