"""MASIA: messages are made into one representation, which is taught to hold what was seen."""

from typing import NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._live_edges import meet_live, weigh_live
from marl_clean.comm._receiving import masked_softmax
from marl_clean.comm.base import Comm, Hearing, Senders, Width, outgoing, place_of
from marl_clean.settings import LayerWidth, NonNegativeFloat


class State(NamedTuple):
    """What robots know: their features and, once they have listened, the representation."""

    feature: Tensor
    represented: Tensor | None = None


@final
class Masia(Comm):
    """Let messages attend to each other, represent them together, and take what concerns oneself.

        m_j = W_m h_j,    S_i = those that i hears, and i itself
        each a in S_i attends to each b in S_i:
            y_ia = sum over b of softmax_b(q_ia . k_ib / sqrt(d)) v_ib
            q_ia, k_ib, v_ib = W_q, W_k, W_v [m, e_i.],    e_ii = 0
        z_i = W_z (mean over a in S_i of relu(y_ia))
        result: [h_i, sigmoid(W_f h_i) z_i]

    The order of messages does not matter, nor how many they are. e_ij says where j is, with
    `places`, and is left out without.

    z_i is also taught by itself, in learning alone (`marl_clean.learning.representing`): by
    `reconstruct` to hold what each robot of S_i sees, by `predict` to foretell the next frame's,
    which iql, vdn and qmix learn, since it takes the target network.

    Source: Guan et al., NeurIPS 2022 (arXiv 2302.09605), and its public code. There all robots are
    heard and are a fixed number, z is side by side one part for each, the same for all robots, and
    it remembers by a GRU (here `encoder.memory`); it reconstructs the true state, whose size here
    differs between houses, and foretells by several steps, and rewards too.

    Args:
        in_features: length of the encoder's features.
        observed: numbers in one robot's observation.
        message_dim: floats in a message.
        key_dim: length d of a query and a key, made by who hears; none is sent.
        hidden: length of a value, and of the representation z.
        reconstruct: weight of the loss of what is seen, from z.
        predict: weight of the loss of the next frame's z, from z and what is done.
        detach: a receiver's loss does not reach the sender's features.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        observed: Width,
        message_dim: LayerWidth,
        key_dim: LayerWidth,
        hidden: LayerWidth,
        reconstruct: NonNegativeFloat,
        predict: NonNegativeFloat,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        self.detach, self.observed = detach, observed
        self.reconstruct, self.predict = reconstruct, predict
        self.sizes = (key_dim, key_dim, hidden)
        self.message = nn.Linear(in_features, message_dim)
        self.parts = nn.Linear(message_dim, sum(self.sizes))
        self.place = hearing.place_layer(sum(self.sizes))
        self.represent = nn.Linear(hidden, hidden)
        self.focus = nn.Linear(in_features, hidden)
        self.message_dims, self.represents = (message_dim,), hidden
        self.give(in_features + hidden, in_features, hearing)

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> State:
        return State(feature)

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent message"]:
        return self.message(outgoing(state.feature, self.detach))

    def listen(
        self,
        state: State,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> State:
        itself = torch.eye(live.shape[-1], dtype=torch.bool, device=live.device)
        member = live | itself
        own, others = self.parts(self.message(state.feature)), self.parts(heard)
        parts = torch.where(itself.unsqueeze(-1), own.unsqueeze(-2), others.unsqueeze(-3))
        if self.place is not None:
            parts = parts + self.place(place_of(senders))
        query, key, value = parts.split(self.sizes, dim=-1)  # [*B, i, a, ...]: a as i hears it
        pairs = member.unsqueeze(-1) & member.unsqueeze(-2)
        share = masked_softmax(meet_live(query, key, pairs) / self.sizes[0] ** 0.5, pairs)
        attended = weigh_live(share, value, pairs).relu()
        among = torch.where(member.unsqueeze(-1), attended, 0.0).sum(-2)
        mean = among / member.sum(-1, keepdim=True)
        return state._replace(represented=self.represent(mean))

    def end(self, state: State) -> Float[Tensor, "*batch agent joined"]:
        assert state.represented is not None
        focused = self.focus(state.feature).sigmoid() * state.represented
        return torch.cat([state.feature, focused], dim=-1)

    def representation(self, state: State) -> Float[Tensor, "*batch agent representation"]:
        assert state.represented is not None
        return state.represented
