"""What schemes must hold in hearing: of whom, where from, and what becomes of it."""

import torch
from torch import Tensor

from marl_clean.comm.base import Comm, Senders
from marl_clean.testing._broken import require, require_close, require_equal
from marl_clean.testing._choosers import Watched
from marl_clean.testing._graphs import draw

TALK = ("feature", "message", "edges", "bits")  # of `Talk`, in its order


def offsets_over_dead_edges_have_no_influence(comm: Comm) -> None:
    """Raise ContractBroken where a result depends on where robots are that are not heard."""
    feature, live, senders = draw(6, n_agents=5, share=0.3)
    assert senders.offset is not None
    known = live.unsqueeze(-1) & torch.tensor(comm.places)
    elsewhere = torch.where(known, senders.offset, torch.nan)
    before = comm(feature, live, senders)
    after = comm(feature, live, senders._replace(offset=elsewhere))
    for name, entry, moved in zip(TALK, before[:4], after[:4], strict=True):
        require_equal(moved, entry, f"{name} depends on where robots out of contact are")


def a_sender_elsewhere_is_heard_elsewhere(comm: Comm) -> None:
    """Raise ContractBroken where `places` is True, and a hearer ignores where its sender is.

    Robot 0 hears robot 1 and nobody else hears anybody, so that i and j are not the same. Where
    robots choose to whom they send, robot 1 hears robot 0 as well, for it may have to be asked.
    """
    if not comm.places or not comm.rounds:
        return
    feature, live, senders = draw(3, n_agents=3, share=0.0)
    live[:, 0, 1], live[:, 1, 0] = True, comm.chooses
    assert senders.offset is not None
    feature = 0.3 * feature + 0.5  # so that gates and relus are open where they can be

    def heard(offset: Tensor) -> Tensor:
        return comm(feature, live, Senders(senders.distance_rank, offset)).feature

    before, hearer = heard(senders.offset), torch.tensor([True, False, False])
    for axis, name in enumerate(("row", "col")):
        moved = senders.offset.clone()
        moved[:, 0, 1, axis] += 2
        changed = (heard(moved) != before).any(-1).any(0)
        require(changed[0], f"the {name} of its sender does not reach robot 0, which hears it")
        if comm.chooses:
            continue
        require_equal(changed, hearer, f"the {name} of robot 1, which robot 0 hears, reaches")
        moved = senders.offset.clone()
        moved[:, 1, 0, axis] += 2
        broken = f"robot 0 hears robot 1, and the {name} of 0 seen from 1 matters to some"
        require_equal(heard(moved), before, broken)


def who_hears_nothing_keeps_its_features(comm: Comm) -> None:
    """Raise ContractBroken where features are joined, and change without a message."""
    if comm.joined is None:
        return
    feature, live, senders = draw(6, n_agents=5, share=0.3)
    delivery = Watched(live)
    after = comm(feature, live, senders, delivery).feature
    hears = torch.stack([torch.zeros_like(live), *delivery.edges]).any(0).any(-1)
    broken = "a robot that hears nothing has other features than before"
    require_equal(after[~hears], feature[~hears], broken)
    changed = (after != feature).any(-1)[hears]
    require(changed, "a robot that hears another has the features that it had before")


def turned(comm: Comm, quarters: int) -> tuple[Tensor, Tensor]:
    """Return what is made of a house, and of the house turned by quarters counterclockwise."""
    feature, live, senders = draw(3, n_agents=4)
    assert senders.offset is not None
    row, col = senders.offset.unbind(-1)
    for _ in range(quarters):
        row, col = -col, row
    rotated = senders._replace(offset=torch.stack([row, col], -1))
    return comm(feature, live, senders).feature, comm(feature, live, rotated).feature


def turning_the_house_matters_only_with_places(comm: Comm) -> None:
    """Raise ContractBroken where a house turned is the same with `places`, or another without."""
    for quarters in (1, 2, 3, 4):
        before, after = turned(comm, quarters)
        if comm.places and comm.rounds and quarters % 4:
            same = torch.equal(before, after)
            require(not same, f"places is True, but {quarters} quarter turns change nothing")
        else:
            require_close(after, before, f"{quarters} quarter turns of the house change features")


def attention_is_paid_over_live_edges(comm: Comm) -> None:
    """Raise ContractBroken where weights are no shares, or fall on dead edges."""
    feature, live, senders = draw(4, n_agents=5)
    attention = comm(feature, live, senders).attention
    if attention is None:
        require(comm.pull == 0, f"pull is {comm.pull}, but there is no attention to pull")
        return
    require(attention.ndim == 4, f"attention is {list(attention.shape)}, not [batch, head, n, n]")
    dead = ~live & ~torch.eye(5, dtype=torch.bool)
    most = attention.masked_fill(~dead[:, None], 0).abs().max().item()
    require(most == 0, f"attention of {most} falls on a dead edge")
    least, sums = attention.min().item(), attention.sum(-1)
    require(least >= 0, f"attention of {least} is negative")
    require(sums <= 1 + 1e-9, f"a robot's attention sums to {sums.max().item()}, more than 1")
