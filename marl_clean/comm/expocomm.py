"""ExpoComm: messages that remember cross to the first, second, fourth, ... nearest."""

from typing import Literal, NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._receiving import sum_live_pairs
from marl_clean.comm.base import Comm, Hearing, Scene, Senders, Width, outgoing, place_of
from marl_clean.settings import LayerWidth, NonNegativeFloat

MOST_POWERS = 16  # of two that are tried: enough for 2^16 robots


class State(NamedTuple):
    """What robots know before and after they listen.

    Attributes:
        feature: the encoder's.
        message: `[*B, n, hidden]`, what each remembers, and sends.
        step: `[*B, n, 1]`, steps since the episode began.
        writes: `[*B, n, n]`, [i, j]: j writes to i.
    """

    feature: Tensor
    message: Tensor
    step: Tensor
    writes: Tensor


@final
class ExpoComm(Comm):
    """Send what is remembered to the 2^k-th nearest in contact, and remember what is heard.

        m_i(0) = 0,    N_i = those who write to i; i itself where nobody does
        u_i = mean over j in N_i of relu(W [h_i, m_j(t - 1), e_ij])
        m_i(t) = GRU(u_i, m_i(t - 1))
        result: [h_i, m_i(t)]
        j writes to its 2^k-th nearest of those in contact with it, k = 0, 1, ..., K_j - 1,
        K_j = 1 + floor(log2 of how many they are)
        all: to each of them in each step;    one: to the one of k = t mod K_j

    Information crosses an edge within a step, but a robot's own features only in the step after:
    what it sends is what it remembered. It begins with nothing at the start of an episode, and is
    learnt from frames in a row. By `reconstruct` m_i(t) is also taught to hold what i and those in
    contact with it see, in learning alone (`marl_clean.learning.representing`).

    Source: arXiv 2502.19717. There robots stand in a ring by their numbers, i hears i + 2^k, and
    what one knows is with all others after about log2(n) steps. Here a robot's number means nothing
    and contact depends on who is near, so that the order is that of distance, which the sender
    knows; how fast information spreads is not promised. The cycle of `one` there has a step in
    which robots hear themselves, which is left out. The GRU is that of `one` there; in the public
    code `all` is attention over messages, into which features enter as queries only, so that
    messages are the same constant for all robots: here `all` is the GRU over the mean.

    Args:
        in_features: length of the encoder's features.
        observed: numbers in one robot's observation.
        hidden: floats in a message, which are what a robot remembers.
        peers: whom a robot writes to in a step.
        reconstruct: weight of the loss of what is seen, from what is remembered.
        detach: a receiver's loss does not reach what the sender remembers.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    def __init__(
        self,
        in_features: Width,
        observed: Width,
        hidden: LayerWidth,
        peers: Literal["one", "all"],
        reconstruct: NonNegativeFloat,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__()
        self.peers, self.detach = peers, detach
        self.own = nn.Linear(in_features, hidden)
        self.others = nn.Linear(hidden, hidden, bias=False)
        self.place = hearing.place_layer(hidden)
        self.update = nn.GRUCell(hidden, hidden)
        self.observed, self.reconstruct, self.represents = observed, reconstruct, hidden
        self.message_dims, self.remembers = (hidden,), hidden + 1
        self.give(in_features + hidden, in_features, hearing)

    def look(self, feature: Float[Tensor, "*batch agent feature"], scene: Scene) -> State:
        message, step = scene.hidden[..., :-1], scene.hidden[..., -1:]
        contact = scene.contact
        rank = torch.where(contact, scene.senders.distance_rank, contact.shape[-1])
        place = 1 + rank.argsort(-1).argsort(-1)  # [j, i]: i is the 1st, 2nd, ... nearest to j
        if self.peers == "all":
            wanted = (place & (place - 1)) == 0
        else:
            powers = 2 ** torch.arange(MOST_POWERS, device=place.device)
            count = (powers <= contact.sum(-1, keepdim=True)).sum(-1, keepdim=True).clamp(min=1)
            wanted = place == powers[step.detach().round().long() % count]
        return State(feature, message, step, (contact & wanted).mT)

    def speak(self, state: State, round_index: int) -> Float[Tensor, "*batch agent hidden"]:
        return outgoing(state.message, self.detach)

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
        own, placed = self.own(state.feature), 0.0
        if self.place is not None:
            placed = self.place(place_of(senders))
        pairs = own.unsqueeze(-2) + self.others(heard).unsqueeze(-3) + placed
        count = live.sum(-1, keepdim=True)
        mean = sum_live_pairs(pairs.relu(), live) / count.clamp(min=1)
        itself = (own + self.others(state.message)).relu()
        taken = torch.where(count > 0, mean, itself).flatten(0, -2)
        remembered = self.update(taken, state.message.flatten(0, -2)).view_as(state.message)
        return state._replace(message=remembered, step=state.step + 1)

    def end(self, state: State) -> Float[Tensor, "*batch agent joined"]:
        return torch.cat([state.feature, state.message], dim=-1)

    def carry(self, state: State) -> Float[Tensor, "*batch agent hidden"]:
        return torch.cat([state.message, state.step], dim=-1)

    def representation(self, state: State) -> Float[Tensor, "*batch agent hidden"]:
        return state.message
