"""What schemes share that join a robot's features with what it received of its neighbours."""

from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._receiving import (
    nearest_live,
    nearest_live_pairs,
    sum_live,
    sum_live_pairs,
)
from marl_clean.comm.base import Comm, Hearing, Senders, Width, dense, with_places


class Joining(Comm):
    """Send one message a step, and join each robot's features with those it receives.

        r_ij = relu(W_r [m_j, e_ij])              a received message, through its own block
        ordered: c_i = [r_ij of i's nearest live edge, of the next, ..., 0 for an empty slot]
        sum:     c_i = sum over live edges of r_ij
        h'_i = relu(W [relu(W_o h_i), c_i])

    e_ij says where j is, with `places`; it is left out without.

    Attributes:
        message: the module from a robot's features to its message.
        slots: neighbours that `ordered` has room for; None for `sum`.
    """

    def __init__(
        self,
        message: nn.Module,
        in_features: Width,
        message_dim: Width,
        hidden: Width,
        received: Width,
        combine: Literal["ordered", "sum"],
        max_neighbours: Width,
        hearing: Hearing,
    ) -> None:
        super().__init__()
        self.slots = max_neighbours if combine == "ordered" else None
        self.message = message
        self.received = dense(message_dim + hearing.place_numbers, received)
        self.own = dense(in_features, hidden)
        self.join = dense(hidden + received * (self.slots or 1), hidden)
        self.message_dims = (message_dim,)
        self.give(hidden, in_features, hearing)

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return self.message(state)

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent joined"]:
        neighbours = self._heard_in_places if self.places else self._heard
        return self.join(torch.cat([self.own(state), neighbours(heard, live, senders)], dim=-1))

    def _heard(self, heard: Tensor, live: Tensor, senders: Senders) -> Tensor:
        """What a robot hears: r_j is the same for all who hear it."""
        received = self.received(heard)
        if self.slots is None:
            return sum_live(received, live)
        return nearest_live(received, live, senders.distance_rank, self.slots)

    def _heard_in_places(self, heard: Tensor, live: Tensor, senders: Senders) -> Tensor:
        """The same of r_ij."""
        received = self.received(with_places(heard, senders))
        if self.slots is None:
            return sum_live_pairs(received, live)
        return nearest_live_pairs(received, live, senders.distance_rank, self.slots)


def message_layers(in_features: int, hidden: int, message_dim: int) -> nn.Sequential:
    """Return the layers that make a message of features: the paper's plan (§3.4, figure 4)."""
    return nn.Sequential(nn.Linear(in_features, hidden), nn.ReLU(), nn.Linear(hidden, message_dim))
