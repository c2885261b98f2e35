"""What every communication scheme takes and gives."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from marl_clean.comm._live_edges import meet_live, weigh_live

Width = int
"""Length of a feature vector; handed over by the network's builder, so never a config key."""

BITS_PER_FLOAT = 32


class NoisyWhileLearning(nn.Module):
    """A part that draws while it learns (`training`), and is a function of its input when used."""


class Delivery(ABC):
    """One step's transport of all messages.

    Attributes:
        sent: `[*B, n, n]` bool, [i, j]: j sends to i, and pays for it, received or not.
        bits_per_number: what a number costs over these channels; None: as the scheme makes it.
    """

    sent: Tensor
    bits_per_number: int | None = None

    @abstractmethod
    def __call__(
        self, message: Float[Tensor, "*batch agent message"], round_index: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        """Send a round's messages; return those heard now, and over which live edges.

        Edge [i, j]: robot i hears the message of robot j.
        """


class Direct(Delivery):
    """Everything arrives at once, as it was sent, over every live edge."""

    def __init__(self, adjacency: Bool[Tensor, "*batch agent other"]) -> None:
        self.sent = adjacency

    def __call__(
        self, message: Float[Tensor, "*batch agent message"], round_index: int
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return message, self.sent


class Senders(NamedTuple):
    """Where the robots that may be heard are, seen from each that may hear them.

    Attributes:
        distance_rank: `[*B, n, n]` int, [i, j]: the rank of j among the others seen from i; 0 is i
            itself, 1 its nearest.
        offset: `[*B, n, n, 2]` float, [i, j]: (row, col) in cells from i to j, 0 over edges that
            are not live or not in contact now; None unless the scheme's `places`.
    """

    distance_rank: Tensor
    offset: Tensor | None = None


class Talk(NamedTuple):
    """The result of one step of communication.

    Attributes:
        feature: `[*B, n, out_features]`, what the robots know now.
        message: `[*B, n, sum of message_dims]`, what each sent, all rounds side by side.
        edges: `[*B, n, rounds]`, over how many edges each sent in each round.
        bits: `[*B, n, 1]`, what that cost.
        attention: `[*B, head, n, n]`, how much each robot attended to each in the last round; None
            of schemes that do not attend.
    """

    feature: Tensor
    message: Tensor
    edges: Tensor
    bits: Tensor
    attention: Tensor | None = None


class Comm(nn.Module, ABC):
    """Let robots talk over a graph: from features of each robot to features that know of others.

        state = begin(h)
        each round: m_j = speak(state)_j,    state_i = listen(state, the m_j that reached i)_i
        h' = end(state)

    A scheme is what is sent and how receivers use it; how messages are changed before they arrive
    is a matter of the channel. A robot sends its message to each robot it may talk to, whether or
    not that robot makes use of it, and every round costs: edges x numbers in a message x bits of a
    number.
    Results depend on live edges only, and not on how the robots are numbered. A dead edge is
    masked, so that not even NaN crosses it, in either direction of the arithmetic (`live_edges`).

    Attributes:
        message_dims: numbers in the message of each round; there are as many rounds as entries,
            and what a robot knows crosses as many edges within one step.
        bits_per_number: what one costs.
        dilutes: what is heard is divided by how many other robots there are, in reach or not.
        detach: a receiver's loss does not reach the sender's features.
        pull: weight of a loss that pulls attention towards that of the next frame.
        delay_steps: steps after which a message is heard, as part of the scheme.
        places: `listen` gets the senders' offsets, which robots in contact know of each other.
        out_features: length of the features it gives.
    """

    message_dims: Sequence[int]
    out_features: int
    bits_per_number: int = BITS_PER_FLOAT
    dilutes: bool = False
    detach: bool = False
    pull: float = 0.0
    delay_steps: int = 0
    places: bool = False

    @property
    def rounds(self) -> int:
        """How often the robots speak within one step."""
        return len(self.message_dims)

    @property
    def gated(self) -> bool:
        """Whether robots may choose to be silent; then their message is all zeros."""
        return type(self).gate is not Comm.gate

    def numbers(self, round_index: int) -> int:
        """Return how many numbers a message of round `round_index` is paid for."""
        return self.message_dims[round_index]

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> Any:
        """Return what the first round starts from: tensors `[*B, n, ...]`, one or several."""
        return feature

    @abstractmethod
    def speak(self, state: Any, round_index: int) -> Float[Tensor, "*batch agent message"]:
        """Return what each robot sends in round `round_index`, the same to all that it talks to."""

    def gate(self, state: Any, round_index: int) -> Float[Tensor, "*batch agent 1"] | None:
        """Return 1 for each robot that speaks and 0 for the others; None: all do."""
        return None

    @abstractmethod
    def listen(
        self,
        state: Any,
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Any:
        """Return the state after a round: robot i heard the message of j over each live [i, j].

        `senders`: where each j is, seen from i.
        """

    def end(self, state: Any) -> Float[Tensor, "*batch agent joined"]:
        """Return the features that the last state comes to."""
        return state

    def attention(self, state: Any) -> Float[Tensor, "*batch head agent other"] | None:
        """Return how much each robot attended to each in the last round, where it does."""
        return None

    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        delivery: Delivery | None = None,
    ) -> Talk:
        """Let the robots talk: round by round, over `delivery`, without one as if at no loss.

        `senders` may hold the offsets of all pairs: those out of contact have no influence.
        """
        delivery = delivery or Direct(adjacency)
        price = min(self.bits_per_number, delivery.bits_per_number or self.bits_per_number)
        state, sent = self.begin(feature), [feature[..., :0]]
        receivers = delivery.sent.sum(-2).unsqueeze(-1).to(feature.dtype)
        edges, bits = [receivers[..., :0]], torch.zeros_like(receivers)
        for round_index in range(self.rounds):
            message, gate = self.speak(state, round_index), self.gate(state, round_index)
            reached = receivers
            if gate is not None:
                message, reached = gate * message, gate.detach() * receivers
            sent.append(message)
            edges.append(reached)
            bits = bits + price * self.numbers(round_index) * reached
            heard, live = delivery(message, round_index)
            audible = self._audible(senders, adjacency & live, heard)
            state = self.listen(state, heard, live, audible, round_index)
        message, reached = torch.cat(sent, dim=-1), torch.cat(edges, dim=-1)
        return Talk(self.end(state), message, reached, bits, self.attention(state))

    def _audible(self, senders: Senders, live: Tensor, heard: Tensor) -> Senders:
        """Return where those are who are heard now, where the scheme asks for it."""
        if not self.places:
            return senders._replace(offset=None)
        assert senders.offset is not None
        if self.gated:  # the silent are not heard: their message is all zeros
            live = live & heard.ne(0).any(-1).unsqueeze(-2)
        return senders._replace(
            offset=torch.where(live.unsqueeze(-1), senders.offset, 0).to(heard.dtype)
        )


def outgoing(feature: Tensor, detach: bool) -> Tensor:
    """Return the features that messages are made of.

    Detached, a receiver's loss does not reach the sender's features; the weights that make the
    message of them, which all robots share, still learn.
    """
    return feature.detach() if detach else feature


def dense(before: int, after: int) -> nn.Sequential:
    """Return a fully connected layer and its ReLU."""
    return nn.Sequential(nn.Linear(before, after), nn.ReLU())


def sum_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
) -> Float[Tensor, "*batch agent width"]:
    """Return for each robot the sum of its live neighbours' values; 0 without any."""
    return weigh_live(adjacency.to(value.dtype), value, adjacency)


def nearest_live(
    value: Float[Tensor, "*batch agent width"],
    adjacency: Bool[Tensor, "*batch agent agent"],
    distance_rank: Int[Tensor, "*batch agent agent"],
    slots: int,
) -> Float[Tensor, "*batch agent joined"]:
    """Return for each robot its live neighbours' values side by side, nearest first.

    There are `slots` of them; one without a robot holds zeros.
    """
    agents, width = value.shape[-2:]
    taken = min(slots, agents)
    beyond_all = torch.full_like(distance_rank, agents)
    live_rank = torch.where(adjacency, distance_rank, beyond_all)
    rank, other = live_rank.topk(taken, dim=-1, largest=False)
    index = other.flatten(-2).unsqueeze(-1)
    gathered = value.gather(-2, index.expand(*index.shape[:-1], width))
    placed = gathered.unflatten(-2, (agents, taken))
    heard = torch.where(rank.unsqueeze(-1) < agents, placed, 0.0).flatten(-2)
    return functional.pad(heard, (0, (slots - taken) * width))


def masked_softmax(
    score: Float[Tensor, "*batch agent other"], live: Bool[Tensor, "*batch agent other"]
) -> Float[Tensor, "*batch agent other"]:
    """Return softmax over the live ones, 0 elsewhere; a row without any is all 0."""
    lowest = torch.finfo(score.dtype).min  # not -inf: a row of those is NaN, and so its gradient
    return torch.where(live, torch.where(live, score, lowest).softmax(-1), 0.0)


def attend(
    query: Float[Tensor, "*batch agent key"],
    message: Float[Tensor, "*batch agent key_and_value"],
    adjacency: Bool[Tensor, "*batch agent agent"],
    scale: float,
    own: Float[Tensor, "*batch agent key_and_value"] | None = None,
) -> tuple[Float[Tensor, "*batch agent value"], Float[Tensor, "*batch agent other"]]:
    """Return what each robot makes of its live neighbours' values by their keys: c and a.

        a_ij = softmax over live j of scale q_i . k_j,    c_i = sum over j of a_ij v_j

    A message is [key, value]. `own`: what a robot would have sent itself; then j = i is live too.
    Without any live j, c_i is exactly 0.
    """
    width = query.shape[-1]
    live = adjacency
    score = scale * meet_live(query, message[..., :width], live)
    if own is not None:  # beside the others, rather than among them
        of_itself = scale * (own[..., :width] * query).sum(-1, keepdim=True)
        score = torch.cat([score, of_itself], dim=-1)
        live = functional.pad(adjacency, (0, 1), value=True)
    weight = masked_softmax(score, live)
    others = weight[..., : adjacency.shape[-1]]
    summed = weigh_live(others, message[..., width:], adjacency)
    if own is None:
        return summed, others
    itself = weight[..., -1:]
    return summed + itself * own[..., width:], others + torch.diag_embed(itself.squeeze(-1))
