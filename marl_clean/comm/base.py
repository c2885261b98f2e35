"""What every communication scheme takes and gives."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor, nn

from marl_clean.comm._join import Join
from marl_clean.comm._layers import dense, outgoing
from marl_clean.comm._receiving import attend, masked_softmax, nearest_live, sum_live
from marl_clean.comm._senders import PLACE, Senders, place_of, with_places
from marl_clean.comm._talk import Delivery, Direct, Scene, Talk, Told
from marl_clean.settings import Ground

__all__ = [
    "BITS_PER_FLOAT",
    "Comm",
    "Delivery",
    "Direct",
    "NoisyWhileLearning",
    "PLACE",
    "Hearing",
    "Scene",
    "Senders",
    "Talk",
    "Width",
    "attend",
    "dense",
    "masked_softmax",
    "nearest_live",
    "outgoing",
    "place_of",
    "sum_live",
    "with_places",
]

Width = int
"""Length of a feature vector; handed over by the network's builder, so never a config key."""

BITS_PER_FLOAT = 32


def _itself(feature: Tensor) -> Tensor:
    return feature


class NoisyWhileLearning(nn.Module):
    """A part that draws while it learns (`training`), and is a function of its input when used."""


@dataclass(frozen=True)
class Hearing:
    """Settings of schemes that are the same for each; each is a key of their yaml.

    Attributes:
        places: a hearer joins each message with e_ij = (row, col, |row|, |col|) / 10 of its sender.
        join: what becomes of the hearer's features, see `Join`; `concat`: what the scheme gives.
        ground: weights of losses on messages, for learners: see `marl_clean.learning.grounding`;
            with `only` receivers' losses do not reach messages.
    """

    places: bool = False
    join: Literal["concat", "residual", "gated"] = "concat"
    ground: Ground = Ground()

    @property
    def place_numbers(self) -> int:
        """By how many numbers a received message is longer."""
        return PLACE if self.places else 0

    def place_layer(self, width: int) -> nn.Linear | None:
        """Return the layer from e_ij to what is added to `width` numbers; None without places.

        W [m_j, e_ij] is W_m m_j + W_e e_ij: this is W_e.
        """
        return nn.Linear(PLACE, width, bias=False) if self.places else None


class Comm(nn.Module, ABC):
    """Let robots talk over a graph: from features of each robot to features that know of others.

        state = begin(h), or look(h, scene)
        each round: m_j = speak(state)_j,    state_i = listen(state, the m_j that reached i)_i
        h' = end(state), or joined with h by `joined`

    A scheme is what is sent and how receivers use it; how messages are changed before they arrive
    is a matter of the channel. A robot sends its message to each robot it may talk to, or to those
    among them that it chooses, whether or not they make use of it, and every round costs: edges x
    numbers in a message x bits of a number.
    Results depend on live edges only, and not on how the robots are numbered. A dead edge is
    masked, so that not even NaN crosses it, in either direction of the arithmetic (`live_edges`).

    Attributes:
        message_dims: numbers in the message of each round; there are as many rounds as entries,
            and what a robot knows crosses at most as many edges within one step.
        bits_per_number: what one costs.
        dilutes: what is heard is divided by how many other robots there are, in reach or not.
        detach: a receiver's loss does not reach the sender's features.
        pull: weight of a loss that pulls attention towards that of the next frame.
        delay_steps: steps after which a message is heard, as part of the scheme.
        places: `listen` gets the senders' offsets, which robots in contact know of each other.
        remembers: numbers that each robot carries to the next step.
        represents: length of what a robot makes of all that it heard, taught by losses of its own.
        reconstruct, predict: weights of these, see `marl_clean.learning.representing`.
        observed: numbers in an observation, of schemes that send or reconstruct it.
        reads, reads_numbers: an entry of the agents, of so many numbers a robot, which `look` finds
            in the scene; None of schemes that take features alone.
        engineered: nothing of its messages is learnt: they are parts of maps, or the env's entries.
        decodes: receivers read in messages what lies around their senders, see `_decoding`.
        out_features: length of the features it gives.
        ground: as in `Hearing`.
        joined: how features and what is heard become these, other than by the scheme itself.
    """

    message_dims: Sequence[int]
    out_features: int
    bits_per_number: int = BITS_PER_FLOAT
    dilutes: bool = False
    detach: bool = False
    pull: float = 0.0
    delay_steps: int = 0
    places: bool = False
    remembers: int = 0
    represents: int = 0
    reconstruct: float = 0.0
    predict: float = 0.0
    observed: int = 0
    engineered: ClassVar[bool] = False
    decodes: ClassVar[bool] = False
    reads: ClassVar[str | None] = None
    reads_numbers: ClassVar[int] = 0

    def __init__(self) -> None:
        super().__init__()
        self.ground = Ground()
        self.joined: Join | None = None  # of this object: a class's would hide the module

    def give(self, width: int, in_features: int, hearing: Hearing) -> None:
        """Declare that `end` returns `width` numbers a robot: the last step of a constructor.

        By `hearing.join` these are the scheme's features, or join those it took, of `in_features`.
        """
        self.places, self.ground = hearing.places, hearing.ground
        if hearing.join == "concat":
            self.out_features = width
        else:
            self.out_features = in_features
            self.joined = Join(hearing.join, in_features, width)

    @property
    def rounds(self) -> int:
        """How often the robots speak within one step."""
        return len(self.message_dims)

    @property
    def gated(self) -> bool:
        """Whether robots may choose to be silent; then their message is all zeros."""
        return type(self).gate is not Comm.gate

    @property
    def chooses(self) -> bool:
        """Whether a robot chooses to which of those that it may talk to it sends."""
        return type(self).choose is not Comm.choose

    @property
    def hops(self) -> int:
        """How many edges what a robot knows crosses within one step."""
        return self.rounds

    def numbers(self, round_index: int) -> int:
        """Return how many numbers a message of round `round_index` is paid for."""
        return self.message_dims[round_index]

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> Any:
        """Return what the first round starts from: tensors `[*B, n, ...]`, one or several."""
        return feature

    def look(self, feature: Float[Tensor, "*batch agent feature"], scene: Scene) -> Any:
        """Return what `begin` does, of schemes that begin with more than features."""
        return self.begin(feature)

    @abstractmethod
    def speak(self, state: Any, round_index: int) -> Float[Tensor, "*batch agent message"]:
        """Return what each robot sends in round `round_index`, the same to all that it talks to."""

    def gate(self, state: Any, round_index: int) -> Float[Tensor, "*batch agent 1"] | None:
        """Return 1 for each robot that speaks and 0 for the others; None: all do."""
        return None

    def choose(self, state: Any, round_index: int) -> Bool[Tensor, "*batch agent other"] | None:
        """Return [i, j]: j sends to i in this round, if it may at all; None: all do."""
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

    def carry(self, state: Any) -> Float[Tensor, "*batch agent hidden"] | None:
        """Return what each robot carries to the next step; None of schemes that carry nothing."""
        return None

    def representation(self, state: Any) -> Float[Tensor, "*batch agent representation"] | None:
        """Return what each robot makes of all that it heard, of schemes that teach it by itself."""
        return None

    def attention(self, state: Any) -> Float[Tensor, "*batch head agent other"] | None:
        """Return how much each robot attended to each in the last round, where it does."""
        return None

    def forward(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        adjacency: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        delivery: Delivery | None = None,
        hidden: Float[Tensor, "*batch agent hidden"] | None = None,
        value: Callable[[Tensor], Tensor] = _itself,
        read: Shaped[Tensor, "*batch agent number"] | None = None,
    ) -> Talk:
        """Let the robots talk: round by round, over `delivery`, without one as if at no loss.

        `senders` may hold the offsets of all pairs: those out of contact have no influence. Without
        `hidden` nothing was carried here; without `value` features are taken for action values;
        `read` is the frames' entry `reads`.
        """
        delivery = delivery or Direct(adjacency)
        price = min(self.bits_per_number, delivery.bits_per_number or self.bits_per_number)
        if hidden is None:
            hidden = feature.new_zeros(*feature.shape[:-1], self.remembers)
        nobody_silent = torch.ones_like(feature[..., :1])
        seen = self._audible(senders, adjacency, nobody_silent)
        scene = Scene(adjacency, delivery.sent, seen, hidden, value, read)
        state, sent = self.look(feature, scene), [feature[..., :0]]
        receivers = delivery.sent.sum(-2).unsqueeze(-1).to(feature.dtype)
        edges, bits = [receivers[..., :0]], torch.zeros_like(receivers)
        hears = torch.zeros_like(adjacency[..., 0])
        for round_index in range(self.rounds):
            message, gate = self.speak(state, round_index), self.gate(state, round_index)
            chosen, reached = self.choose(state, round_index), receivers
            if chosen is not None:
                reached = (delivery.sent & chosen).sum(-2).unsqueeze(-1).to(feature.dtype)
            if gate is not None:
                message, reached = gate * message, gate.detach() * reached
            sent.append(message)
            edges.append(reached)
            bits = bits + price * self.numbers(round_index) * reached
            sent_on = message.detach() if self.ground.only else message
            heard, live = delivery(sent_on, round_index, chosen)
            hears = hears | live.any(-1)
            audible = self._audible(senders, adjacency & live, heard)
            state = self.listen(state, heard, live, audible, round_index)
        message, reached = torch.cat(sent, dim=-1), torch.cat(edges, dim=-1)
        given = self.end(state)
        if self.joined is not None:
            given = self.joined(feature, given, hears)
        further = (self.attention(state), self.carry(state), self.representation(state))
        told = Told(heard, live) if self.decodes else None
        return Talk(given, message, reached, bits, *further, told)

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
