"""What schemes must hold that choose over which edges they send, and what all pay for it."""

from itertools import product

import torch
from torch import Tensor

from marl_clean.comm.base import BITS_PER_FLOAT, Comm, Direct
from marl_clean.testing._broken import require, require_equal
from marl_clean.testing._graphs import draw, require_unheard


class Watched(Direct):
    """Deliver at once, and keep over which edges each round sent; in one a message may be NaN."""

    def __init__(
        self, adjacency: Tensor, poisoned: int | None = None, in_round: int | None = None
    ) -> None:
        super().__init__(adjacency)
        self.poisoned, self.in_round = poisoned, in_round
        self.edges: list[Tensor] = []

    def __call__(
        self, message: Tensor, round_index: int, chosen: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        heard, live = super().__call__(message, round_index, chosen)
        self.edges.append(live)
        heard = heard.clone()  # poisoned or not, so that both are computed alike to the last digit
        if round_index == self.in_round:
            heard[..., self.poisoned, :] = torch.nan
        return heard, live

    def reach(self, since: int) -> Tensor:
        """Return whether what j sent in a round gets to i, in later rounds over others: [i, j]."""
        reach = torch.eye(self.sent.shape[-1], dtype=torch.float64).expand(self.sent.shape)
        for live in self.edges[since:]:
            reach = reach + live.to(reach.dtype) @ reach
        return reach > 0


def bits_are_those_sent(comm: Comm, observed: int | None) -> None:
    """Raise ContractBroken where edges or bits are not those of what was sent.

    `observed`: numbers in an observation, of schemes that send it.
    """
    feature, live, senders = draw(4, n_agents=5)
    delivery = Watched(live)
    talk = comm(feature, live, senders, delivery)
    receivers = live.sum(-2).unsqueeze(-1).to(talk.bits.dtype)
    edges, bits = [receivers[..., :0]], torch.zeros_like(talk.bits)
    parts = talk.message.split(list(comm.message_dims[: comm.rounds]), dim=-1)
    for round_index, part in enumerate(parts if comm.rounds else ()):
        spoken = part.ne(0).any(-1, keepdim=True) if comm.gated else torch.ones_like(receivers)
        reached = delivery.edges[round_index].sum(-2).unsqueeze(-1)
        edges.append(reached * spoken)
        sent = part.shape[-1] if observed is None else observed
        numbers = comm.numbers(round_index)
        require(numbers == sent, f"round {round_index} sends {sent} numbers and pays for {numbers}")
        bits = bits + comm.bits_per_number * sent * edges[-1]
    require_equal(talk.edges, torch.cat(edges, -1), "edges are not those that were sent over")
    require_equal(talk.bits, bits, "bits are not those of the numbers sent")
    most = 2**comm.bits_per_number if comm.bits_per_number < BITS_PER_FLOAT else None
    values = talk.message.unique().numel()
    broken = f"{values} different values in messages of {comm.bits_per_number} bits a number"
    require(most is None or values <= most, broken)


def nothing_crosses_what_is_not_chosen(comm: Comm) -> None:
    """Raise ContractBroken where a robot hears another that did not send to it."""
    if not comm.chooses:
        return
    feature, live, senders = draw(6, n_agents=5)
    chosen, left_out = torch.zeros(2, comm.rounds, dtype=torch.bool)
    for scale in (1, 10, 100):  # weights as they are drawn may choose alike in like situations
        clean = Watched(live)
        before = comm(scale * feature, live, senders, clean).feature
        for sender, in_round in product(range(5), range(comm.rounds)):
            poisoned = Watched(live, sender, in_round)
            after = comm(scale * feature, live, senders, poisoned).feature
            reach = clean.reach(in_round) | poisoned.reach(in_round)
            require_unheard(after, before, reach, sender, f"NaN in round {in_round}")
        chosen |= torch.stack([edges.any() for edges in clean.edges])
        left_out |= torch.stack([(live & ~edges).any() for edges in clean.edges])
    require(chosen, f"nobody sends to anybody in rounds {(~chosen).nonzero().flatten().tolist()}")
    require(left_out.any(), "chooses is True, and yet all send to all")
