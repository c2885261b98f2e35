"""DGN: attention over neighbours and self in rounds, whose features all reach the Q head."""

from typing import final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Hearing, Senders, Width, attend, dense, outgoing, place_of
from marl_clean.settings import LayerWidth, NonNegativeFloat, PositiveInt

State = tuple[list[Tensor], Tensor | None]  # features of all rounds so far, the last attention


@final
class Dgn(Comm):
    """Attend to neighbours and oneself with several heads, and keep the features of all rounds.

        head m: a_ij = softmax over i and its live edges of q_i . k_ij / sqrt(d)
                c_i^m = sum over j of a_ij v_ij
                q_i = W_q^m h_i,  k_ij = W_k^m [h_j, e_ij],  v_ij = W_v^m [h_j, e_ij]
        each round: h'_i = relu(W [c_i^1, ..., c_i^M])
        result: [h^0, h^1, ..., h^K], h^0 the encoder's

    A robot sends its features h, and each receiver makes keys and values of them; each round
    has weights of its own. e_ij says where j is, with `places`, and is left out without; e_ii = 0.

    With `pull`, a loss holds each robot's attention in the last round to what it will be: the
    learner adds pull x KL(a || a'), mean over heads and robots, a' of the next frame's observations
    over this frame's graph, and constant. A learner with n-step windows looks n steps ahead.

    Source: arXiv 1810.09202, where the pull is called temporal relation regularisation.

    Args:
        in_features: length of the encoder's features.
        hidden: width of each round's features; a later round sends those.
        heads: attention heads M.
        head_dim: length d of a head's query, key and value.
        rounds: messages a step; each is paid for.
        detach: a receiver's loss does not reach the sender's features.
        pull: weight of the loss that pulls attention towards the next frame's; 0: none.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        hidden: LayerWidth,
        heads: PositiveInt,
        head_dim: LayerWidth,
        rounds: PositiveInt,
        detach: bool,
        pull: NonNegativeFloat = 0.0,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        self.heads, self.detach, self.pull = heads, detach, pull
        self.scale = head_dim**-0.5
        widths, joined = [in_features] + [hidden] * (rounds - 1), heads * head_dim
        self.query = nn.ModuleList(nn.Linear(width, joined) for width in widths)
        self.key_and_value = nn.ModuleList(nn.Linear(width, 2 * joined) for width in widths)
        self.join = nn.ModuleList(dense(joined, hidden) for _ in widths)
        self.message_dims = widths
        self.place = nn.ModuleList(filter(None, (hearing.place_layer(2 * joined) for _ in widths)))
        self.give(in_features + rounds * hidden, in_features, hearing)

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> State:
        return [feature], None

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent message"]:
        return outgoing(state[0][-1], self.detach)

    def listen(
        self,
        state: State,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> State:
        (*before, last), _ = state
        query, key_and_value = self.query[round_index], self.key_and_value[round_index]
        own = self.by_head(key_and_value(last))
        unchanged = heard is last  # by the channel: then keys and values are made once, for all
        every_head = live.unsqueeze(-3).expand(*live.shape[:-2], self.heads, *live.shape[-2:])
        summed, attention = attend(
            self.by_head(query(last)),
            own if unchanged else self.by_head(key_and_value(heard)),
            every_head,
            self.scale,
            own=own,
            place=self._places(senders, round_index),
        )
        new = self.join[round_index](summed.transpose(-2, -3).flatten(-2))
        return [*before, last, new], attention

    def end(self, state: State) -> Float[Tensor, "*batch agent joined"]:
        return torch.cat(state[0], dim=-1)

    def attention(self, state: State) -> Float[Tensor, "*batch head agent other"] | None:
        return state[1]

    def _places(self, senders: Senders, round_index: int) -> Tensor | None:
        """What is added to keys and values, `[*B, heads, n, n, 2 d]`, with `places`."""
        if not self.places:
            return None
        place = self.place[round_index](place_of(senders))
        return place.unflatten(-1, (self.heads, -1)).movedim(-2, -4)

    def by_head(
        self, value: Float[Tensor, "*batch agent joined"]
    ) -> Float[Tensor, "*batch head agent part"]:
        """Return one part of the vector for each head, as a batch of heads."""
        return value.unflatten(-1, (self.heads, -1)).transpose(-2, -3)
