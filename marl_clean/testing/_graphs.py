"""Features of robots and graphs between them, and what must not cross these."""

from collections.abc import Callable

import torch
from jaxtyping import Bool
from torch import Tensor

from marl_clean.comm.base import Senders
from marl_clean.testing._broken import require

FEATURES = 12


def draw(
    *batch: int, n_agents: int, share: float = 0.5, seed: int = 0
) -> tuple[Tensor, Tensor, Senders]:
    """Return features, a graph with this share of live edges, and who is where."""
    generator = torch.Generator().manual_seed(seed)
    rand = torch.rand(*batch, n_agents, n_agents, generator=generator)
    live = (rand < share).triu(1)
    place = torch.rand(*batch, n_agents, 2, generator=generator)
    rank = torch.cdist(place, place).argsort(-1).argsort(-1)
    feature = torch.randn(*batch, n_agents, FEATURES, generator=generator, dtype=torch.float64)
    cell = (10 * place).to(torch.float64)
    return feature, live | live.mT, Senders(rank, cell.unsqueeze(-3) - cell.unsqueeze(-2))


def line(length: int) -> tuple[Tensor, Senders, Tensor]:
    """Return robots in a row, each in contact with the next: live edges, places, hops apart."""
    place = torch.arange(length)
    hops = (place - place[:, None]).abs()
    rank = hops.mul(2).add(place > place[:, None]).argsort(-1).argsort(-1)
    along = (place - place[:, None]).to(torch.float64)
    return hops == 1, Senders(rank, torch.stack([torch.zeros_like(along), along], -1)), hops


def each(senders: Senders, change: Callable[[Tensor], Tensor]) -> Senders:
    """Return ranks and offsets changed alike."""
    assert senders.offset is not None
    return Senders(change(senders.distance_rank), change(senders.offset))


def of_robots(senders: Senders, robots: Tensor) -> Senders:
    """Return who is where among these robots alone, in this order."""
    rank, offset = senders
    assert offset is not None
    among = rank[..., robots, :][..., robots].argsort(-1).argsort(-1)
    return Senders(among, offset[..., robots, :, :][..., robots, :])


def within(live: Tensor, rounds: int) -> Bool[Tensor, "..."]:
    """Whether j is i itself or at most `rounds` live edges away."""
    itself = torch.eye(live.shape[-1], dtype=torch.float64).expand(live.shape)
    return torch.linalg.matrix_power(itself + live, rounds) > 0


def require_unheard(after: Tensor, before: Tensor, reach: Tensor, sender: int, what: str) -> None:
    """Raise ContractBroken where the result of a robot that `sender` does not reach changes."""
    wrong = (after != before).any(-1) & ~reach[..., sender]
    if wrong.any():
        place = tuple(wrong.nonzero()[0].tolist())
        number = int((after[place] != before[place]).nonzero()[0])
        values = f"{before[place][number].item()} became {after[place][number].item()}"
        require(False, f"{what} of robot {sender} crosses a dead edge to {list(place)}: {values}")
