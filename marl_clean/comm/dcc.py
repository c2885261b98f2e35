"""DCC: a robot asks those whose absence would change what it does, and they reply."""

from typing import NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._senders import PLACE
from marl_clean.comm.base import (
    Comm,
    Hearing,
    Scene,
    Senders,
    Width,
    attend,
    dense,
    outgoing,
    place_of,
)
from marl_clean.errors import BadInput
from marl_clean.settings import LayerWidth, PositiveInt


class State(NamedTuple):
    """What robots know, round after round.

    Attributes:
        known: `[*B, n, F]`, z of the equations.
        writes: `[*B, n, n]`, [i, j]: j writes to i in the next round.
    """

    known: Tensor
    writes: Tensor


class Exchange(nn.Module):
    """One round: attend to what is heard, and update what is known by a GRU.

    m_j = W_m norm(z_j)
    head: a_ij = softmax over live edges of q_i . k_ij / sqrt(d),    c_i = sum over j of a_ij v_ij
          q_i = W_q norm(z_i),    k_ij, v_ij = W_k [m_j, e_ij], W_v [m_j, e_ij]
    z'_i = GRU(W_c [c_i of each head], z_i),    z_i where nothing is heard
    """

    def __init__(self, width: int, message_dim: int, heads: int, head_dim: int) -> None:
        super().__init__()
        joined = heads * head_dim
        self.heads, self.scale = heads, head_dim**-0.5
        self.norm = nn.LayerNorm(width)
        self.message = nn.Linear(width, message_dim)
        self.query = nn.Linear(width, joined)
        self.key_and_value = nn.Linear(message_dim, 2 * joined)
        self.place = nn.Linear(PLACE, 2 * joined, bias=False)
        self.together = nn.Linear(joined, joined)
        self.update = nn.GRUCell(joined, width)

    def speak(
        self, known: Float[Tensor, "*batch agent width"]
    ) -> Float[Tensor, "*batch agent message"]:
        return self.message(self.norm(known))

    def forward(
        self,
        known: Float[Tensor, "*batch agent width"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        place: Float[Tensor, "*batch agent other place"],
    ) -> Float[Tensor, "*batch agent width"]:
        every_head = live.unsqueeze(-3).expand(*live.shape[:-2], self.heads, *live.shape[-2:])
        summed, _ = attend(
            self._by_head(self.query(self.norm(known))),
            self._by_head(self.key_and_value(heard)),
            every_head,
            self.scale,
            place=self.place(place).unflatten(-1, (self.heads, -1)).movedim(-2, -4),
        )
        given = self.together(summed.transpose(-2, -3).flatten(-2))
        updated = self.update(given.flatten(0, -2), known.flatten(0, -2)).view_as(known)
        return torch.where(live.any(-1, keepdim=True), updated, known)

    def _by_head(self, value: Tensor) -> Tensor:
        return value.unflatten(-1, (self.heads, -1)).transpose(-2, -3)


@final
class Dcc(Comm):
    """Ask those whose absence would change the best action, and hear the replies of those asked.

        p_ij = relu(W_p e_ij) of each j in contact          what i sees of j: where it is
        z_i = h_i + sum over j of p_ij
        i asks j if argmax_a Q(z_i, a) != argmax_a Q(z_i - p_ij, a)
        request: z'_j = exchange(z_j, the z of those who ask j)
        reply:   z''_i = exchange'(z_i', the z' of those who heard i's request)
        result: z''

    Q is the network's head, the same that is applied to the result; as z has the result's length
    and is the result where nothing is heard, it is learnt for both. Request and reply are paid for
    alike. What is asked for has no gradient; what is heard does. A best action is that of the
    largest value or logit.

    Source: arXiv 2109.05413. There j is taken out of the observation, an image with a plane of
    robots, and the encoder runs once more for each j. Observations here differ, so that what i
    sees of j is a term of its own, by the offset that robots in contact know; a robot that the
    observation shows too stays in h_i. There, too, a robot's memory includes what it heard.

    Args:
        in_features: length of the encoder's features, and of the result.
        message_dim: floats in a request, and in a reply.
        heads: attention heads.
        head_dim: length d of a head's query, key and value, made by who hears.
        detach: a receiver's loss does not reach the sender's features.
        hearing: `places` must be true; `join`: see `marl_clean.comm.base.Hearing`.

    Raises:
        BadInput: `places` is false.
    """

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        heads: PositiveInt,
        head_dim: LayerWidth,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        if not hearing.places:
            raise BadInput("comm.places: false, but dcc asks others by where they are; valid: true")
        self.detach = detach
        self.presence = dense(PLACE, in_features)
        self.exchanges = nn.ModuleList(
            Exchange(in_features, message_dim, heads, head_dim) for _ in range(2)
        )
        self.message_dims = (message_dim, message_dim)
        self.give(in_features, in_features, hearing)

    def look(self, feature: Float[Tensor, "*batch agent feature"], scene: Scene) -> State:
        contact = scene.contact.unsqueeze(-1)
        present = torch.where(contact, self.presence(place_of(scene.senders)), 0.0)
        known = feature + present.sum(-2)
        with torch.no_grad():
            best = scene.value(known).argmax(-1)
            best_without = scene.value(known.unsqueeze(-2) - present).argmax(-1)
        asks = scene.contact & (best_without != best.unsqueeze(-1))
        return State(known, asks.mT)

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent message"]:
        exchange = self.exchanges[round_index]
        assert isinstance(exchange, Exchange)
        return exchange.speak(outgoing(state.known, self.detach))

    def choose(self, state: State, round_index: int) -> Bool[Tensor, "*batch agent other"]:
        return state.writes

    def listen(
        self,
        state: State,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> State:
        exchange = self.exchanges[round_index]
        return State(exchange(state.known, heard, live, place_of(senders)), live.mT)

    def end(self, state: State) -> Float[Tensor, "*batch agent joined"]:
        return state.known
