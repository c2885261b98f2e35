"""One step of communication: what a scheme begins with, how messages travel, what comes out."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.comm._senders import Senders


class Delivery(ABC):
    """One step's transport of all messages.

    Attributes:
        sent: `[*B, n, n]` bool, [i, j]: j may send to i, and pays for what it sends, received or
            not.
        bits_per_number: what a number costs over these channels; None: as the scheme makes it.
    """

    sent: Tensor
    bits_per_number: int | None = None

    @abstractmethod
    def __call__(
        self,
        message: Float[Tensor, "*batch agent message"],
        round_index: int,
        chosen: Bool[Tensor, "*batch agent other"] | None = None,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        """Send a round's messages; return those heard now, and over which live edges.

        Edge [i, j]: robot i hears the message of robot j. They are sent over `chosen` edges among
        `sent`, without over all.
        """


class Direct(Delivery):
    """Everything arrives at once, as it was sent, over every live edge."""

    def __init__(self, adjacency: Bool[Tensor, "*batch agent other"]) -> None:
        self.sent = adjacency

    def __call__(
        self,
        message: Float[Tensor, "*batch agent message"],
        round_index: int,
        chosen: Bool[Tensor, "*batch agent other"] | None = None,
    ) -> tuple[Float[Tensor, "*batch agent message"], Bool[Tensor, "*batch agent other"]]:
        return message, self.sent if chosen is None else self.sent & chosen


class Scene(NamedTuple):
    """What robots have before anything is said, beside their features.

    Attributes:
        contact: `[*B, n, n]` bool, [i, j]: i and j are in contact.
        sent: the same, [i, j]: j may send to i; less than contact over some channels.
        senders: where those in contact are.
        hidden: `[*B, n, remembers]`, what each carried from the step before; zeros at first.
        value: from features `[..., out_features]` to the values of actions; the network's head.
        read: `[*B, n, reads_numbers]`, the entry of frames that the scheme `reads`; None: none.
    """

    contact: Tensor
    sent: Tensor
    senders: Senders
    hidden: Tensor
    value: Callable[[Tensor], Tensor]
    read: Tensor | None


class Told(NamedTuple):
    """What was heard in a step's last round, of schemes whose receivers decode it.

    Attributes:
        heard: `[*B, n, numbers]`, the message of each sender as it arrived.
        live: `[*B, n, n]` bool, [i, j]: i heard j.
    """

    heard: Tensor
    live: Tensor


class Talk(NamedTuple):
    """The result of one step of communication.

    Attributes:
        feature: `[*B, n, out_features]`, what the robots know now.
        message: `[*B, n, sum of message_dims]`, what each sent, all rounds side by side.
        edges: `[*B, n, rounds]`, over how many edges each sent in each round.
        bits: `[*B, n, 1]`, what that cost.
        attention: `[*B, head, n, n]`, how much each robot attended to each in the last round; None
            of schemes that do not attend.
        hidden: `[*B, n, remembers]`, what each robot carries to the next step; None of schemes that
            carry nothing.
        represented: `[*B, n, represents]`, what each makes of all that it heard; None of schemes
            that do not teach it by itself.
        told: what was heard, of schemes that `decodes`; None of others.
    """

    feature: Tensor
    message: Tensor
    edges: Tensor
    bits: Tensor
    attention: Tensor | None = None
    hidden: Tensor | None = None
    represented: Tensor | None = None
    told: Told | None = None
