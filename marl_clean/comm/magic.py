"""MAGIC: a scheduler opens and shuts each edge, and graph attention hears over the open ones."""

from typing import NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from marl_clean.comm._gates import open_or_shut
from marl_clean.comm._graph_attention import GraphAttention
from marl_clean.comm.base import (
    Comm,
    Hearing,
    NoisyWhileLearning,
    Senders,
    Width,
    outgoing,
    place_of,
)
from marl_clean.settings import LayerWidth, PositiveFloat, PositiveInt


class State(NamedTuple):
    """What robots know, round after round; None is not known yet.

    Attributes:
        feature: the encoder's.
        signal: `[*B, n, signal]`, what the scheduler goes by.
        heard: what the last processor gave.
        live: over which edges signals were heard.
        gates: `[*B, n, n]` of each processor, [i, j]: whether j speaks to i.
        place: where senders are, `[*B, n, n, 4]`.
        attention: of the last processor.
    """

    feature: Tensor
    signal: Tensor | None = None
    heard: Tensor | None = None
    live: Tensor | None = None
    gates: tuple[Tensor, Tensor] | None = None
    place: Tensor | None = None
    attention: Tensor | None = None


class Schedule(NoisyWhileLearning):
    """Decide for each edge whether its sender speaks, by what the two robots signalled.

    g_ij = 1 or 0 by the logit l_ij = w . relu(W [s_i, s_j, e_ij]); see `open_or_shut`
    """

    def __init__(self, signal: int, place: int, temperature: float) -> None:
        super().__init__()
        pair = 2 * signal + place
        self.logit = nn.Sequential(nn.Linear(pair, signal), nn.ReLU(), nn.Linear(signal, 1))
        self.temperature = temperature

    def forward(
        self, pair: Float[Tensor, "*batch agent other pair"]
    ) -> Float[Tensor, "*batch agent other"]:
        return open_or_shut(self.logit(pair).squeeze(-1), self.temperature, self.training)


@final
class Magic(Comm):
    """Signal in two rounds, speak over the edges that the signals open, and attend twice.

        u_j = W_u h_j                               to all in contact
        s_i = attention over all heard of u, self included
        s_j                                         to all in contact
        g_ij, g'_ij = schedule(s_i, s_j)            0 or 1; j speaks to i where it is 1
        m_j = W_m h_j                               where g is open
        c_i = elu(attention of several heads, by g)
        c_j                                         where g' is open
        c'_i = attention of one head, by g'
        result: [h_i, c'_i]

    Attention is `GraphAttention`, where a robot always hears itself. What the scheduler goes by is
    sent and paid for like any message: 2 signals to all in contact, then 2 messages over the open
    edges. The sender decides; so it must have heard the receiver's signal, and the receiver the
    sender's. A gate learns from its receiver's loss, also where it is shut.

    Source: Niu, Paleja, Gombolay, AAMAS 2021, p. 964, and its public code (`learn_second_graph`,
    `directed`, normalised coefficients). There the scheduler is one module that has all messages at
    no cost, whether a robot hears itself is scheduled too or forced, and it learns by actor-critic.

    Args:
        in_features: length of the encoder's features.
        signal_dim: floats in each of the two signals.
        message_dim: floats in the first message.
        heads: heads of the first attention, and of the scheduler's.
        head_dim: length of a head of the first attention; the second message has `heads` times it.
        hidden: length of what the second attention gives.
        temperature: of the gates' gradient; lower is nearer to a step, and steeper.
        detach: a receiver's loss does not reach the sender's features.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        signal_dim: LayerWidth,
        message_dim: LayerWidth,
        heads: PositiveInt,
        head_dim: LayerWidth,
        hidden: LayerWidth,
        temperature: PositiveFloat,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        self.detach = detach
        second = heads * head_dim
        self.signal = nn.Linear(in_features, signal_dim)
        self.message = nn.Linear(in_features, message_dim)
        self.overview = GraphAttention(signal_dim, signal_dim, heads, mean=True)
        self.schedules = nn.ModuleList(
            Schedule(signal_dim, hearing.place_numbers, temperature) for _ in range(2)
        )
        self.processors = nn.ModuleList(
            [
                GraphAttention(message_dim, head_dim, heads, mean=False),
                GraphAttention(second, hidden, 1, mean=True),
            ]
        )
        widths = (heads * signal_dim, second, hidden)
        self.place = nn.ModuleList(filter(None, (hearing.place_layer(each) for each in widths)))
        self.message_dims = (signal_dim, signal_dim, message_dim, second)
        self.give(in_features + hidden, in_features, hearing)

    @property
    def hops(self) -> int:
        """One fewer than rounds: the second signal decides who speaks, and goes no further."""
        return 3

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> State:
        return State(feature)

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent message"]:
        if round_index == 0:
            return self._first_signal(state)
        if round_index == 2:
            return self.message(outgoing(state.feature, self.detach))
        if round_index == 1:
            assert state.signal is not None
            return state.signal
        assert state.heard is not None
        return outgoing(state.heard, self.detach)

    def _first_signal(self, state: State) -> Tensor:
        return self.signal(outgoing(state.feature, self.detach))

    def choose(self, state: State, round_index: int) -> Bool[Tensor, "*batch agent other"] | None:
        if round_index < 2:
            return None
        assert state.gates is not None
        return state.gates[round_index - 2] > 0

    def listen(
        self,
        state: State,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> State:
        if round_index == 0:
            own, placed = self._first_signal(state), self._placed(0, senders)
            signal, _ = self.overview(own, heard, live, place=placed)
            return state._replace(signal=signal)
        if round_index == 1:
            return self._schedule(state, heard, live, senders)
        return self._process(state, heard, live, round_index - 2)

    def _schedule(self, state: State, heard: Tensor, live: Tensor, senders: Senders) -> State:
        """Decide over which edges the sender speaks to the receiver: those of mutual signals."""
        assert state.signal is not None
        place = place_of(senders) if self.places else None
        sender = state.signal.unsqueeze(-3).expand(*live.shape, -1)
        receiver = heard.unsqueeze(-2).expand(*live.shape, -1)  # as the sender heard it
        mutual = live & live.mT
        pair = torch.cat([receiver, sender, *([] if place is None else [place])], dim=-1)
        pair = torch.where(mutual.unsqueeze(-1), pair, 0.0)
        first, second = (schedule(pair) * mutual for schedule in self.schedules)
        return state._replace(live=live, gates=(first, second), place=place)

    def _process(self, state: State, heard: Tensor, live: Tensor, index: int) -> State:
        """Attend over the edges that are open, which gates learn from, and from the shut ones."""
        assert state.live is not None and state.gates is not None
        gate = state.gates[index]
        gate = live.to(heard.dtype) + (gate - gate.detach())
        own = self.message(state.feature) if index == 0 else state.heard
        edges = live | state.live if self.training else live
        placed = None if state.place is None else self.place[1 + index](state.place)
        summed, attention = self.processors[index](own, heard, edges, gate, placed)
        after = functional.elu(summed) if index == 0 else summed
        return state._replace(heard=after, attention=attention)

    def _placed(self, index: int, senders: Senders) -> Tensor | None:
        return self.place[index](place_of(senders)) if self.places else None

    def end(self, state: State) -> Float[Tensor, "*batch agent joined"]:
        assert state.heard is not None
        return torch.cat([state.feature, state.heard], dim=-1)

    def attention(self, state: State) -> Float[Tensor, "*batch head agent other"] | None:
        return state.attention
