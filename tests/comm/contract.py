"""What every communication scheme must hold, as checks that a scheme passes or fails."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from torch import Tensor

from marl_clean.build import make_comm
from marl_clean.comm.base import Comm

FEATURES = 12
OBSERVED = torch.Size([2, 5, 5])
CONF = Path(__file__).parents[2] / "conf" / "comm"
LEVELS = [(path.stem, {}) for path in sorted(CONF.glob("*.yaml"))]
ALL: list[tuple[str, dict[str, Any]]] = [
    *LEVELS,
    ("plan", {"combine": "sum"}),
    ("plan", {"max_neighbours": 1}),
    ("zeroed", {"combine": "sum"}),
    ("full_state", {"combine": "sum"}),
    ("full_state", {"detach": True}),
    ("commnet", {"rounds": 1}),
    ("commnet", {"rounds": 3, "detach": True}),
    ("commnet", {"divisor": "others"}),
    ("commnet", {"divisor": "others", "rounds": 1}),
    ("tarmac", {"rounds": 3}),
    ("tarmac", {"rounds": 2, "self_included": True}),
    ("tarmac", {"self_included": True, "detach": True}),
    ("ic3net", {"rounds": 2, "detach": True}),
    ("dial", {"combine": "sum"}),
    ("dgn", {"rounds": 1, "heads": 1}),
    ("dgn", {"detach": True}),
]


def make(level: str, **changes: Any) -> Comm:
    torch.manual_seed(0)
    section = OmegaConf.merge(OmegaConf.load(CONF / f"{level}.yaml"), changes)
    return make_comm(section, FEATURES, OBSERVED).double().eval()


VARIANTS = [variant for variant in ALL if not make(variant[0], **variant[1]).dilutes]
DILUTED = [variant for variant in ALL if variant not in VARIANTS]
"""Whose result depends on how many robots there are, by definition."""


def draw(*batch: int, n_agents: int, share: float = 0.5, seed: int = 0):
    """Features, a symmetric graph, and the ranks that random places give."""
    generator = torch.Generator().manual_seed(seed)
    rand = torch.rand(*batch, n_agents, n_agents, generator=generator)
    live = (rand < share).triu(1)
    place = torch.rand(*batch, n_agents, 2, generator=generator)
    rank = torch.cdist(place, place).argsort(-1).argsort(-1)
    feature = torch.randn(*batch, n_agents, FEATURES, generator=generator, dtype=torch.float64)
    return feature, live | live.mT, rank


def within(live: Tensor, rounds: int) -> Tensor:
    """Whether j is i itself or at most so many live edges away."""
    itself = torch.eye(live.shape[-1], dtype=torch.float64).expand(live.shape)
    return torch.linalg.matrix_power(itself + live, rounds) > 0


def gated(comm: Comm) -> bool:
    """Whether robots may choose to be silent."""
    feature = torch.zeros(1, FEATURES, dtype=torch.float64)
    return comm.rounds > 0 and comm.gate(comm.begin(feature), 0) is not None


def shapes(comm: Comm) -> None:
    for batch in ((), (1,), (5,), (2, 3)):
        for n_agents in (1, 2, 5):
            feature, message, edges, bits = comm(*draw(*batch, n_agents=n_agents))[:4]
            assert feature.shape == (*batch, n_agents, comm.out_features)
            assert message.shape[:-1] == (*batch, n_agents)
            assert message.shape[-1] == sum(comm.message_dims[: comm.rounds])
            assert edges.shape == (*batch, n_agents, comm.rounds)
            assert bits.shape == (*batch, n_agents, 1)


def relabelling_the_robots_relabels_the_result(comm: Comm) -> None:
    for n_agents in (2, 3, 6):
        feature, live, rank = draw(4, n_agents=n_agents)
        order = torch.randperm(n_agents, generator=torch.Generator().manual_seed(1))
        relabelled = comm(feature[:, order], live[:, order][..., order], rank[:, order][..., order])
        for mine, theirs in zip(comm(feature, live, rank)[:4], relabelled[:4], strict=True):
            torch.testing.assert_close(mine[:, order], theirs)


def a_dead_edge_has_no_influence_not_even_nan_and_no_gradient(comm: Comm) -> None:
    feature, live, rank = draw(6, n_agents=5, share=0.3)
    reach, before = within(live, comm.rounds), comm(feature, live, rank)[0]
    for sender in range(5):
        deaf = ~reach[:, :, sender]
        inputs = feature.clone().requires_grad_()
        comm(inputs, live, rank)[0][deaf].sum().backward()
        assert not inputs.grad[:, sender].any()
        poisoned = feature.clone()
        poisoned[:, sender] = torch.nan
        poisoned.requires_grad_()
        after = comm(poisoned, live, rank)[0]
        assert torch.equal(after[deaf], before[deaf])
        after[deaf].sum().backward()
        # Who hears the poisoned one hands 0 x NaN back to whom it hears, and no further.
        untouched = ~within(live, 2 * comm.rounds)[:, :, sender]
        assert poisoned.grad[untouched].isfinite().all()


def gradient_crosses_exactly_the_edges_within_the_rounds(comm: Comm) -> None:
    feature, live, rank = draw(4, n_agents=4, share=0.4)
    feature.requires_grad_()
    torch.manual_seed(0)
    joined, message, *_ = comm.train()(feature, live, rank)  # in use bits and gates have none
    comm.eval()
    reach, itself = within(live, comm.rounds), torch.eye(4, dtype=torch.bool)
    crosses = message.shape[-1] > 0 and not getattr(comm, "detach", False)
    for world in range(4):
        for receiver in range(4):
            (grad,) = torch.autograd.grad(joined[world, receiver].sum(), feature, retain_graph=True)
            touched = grad.abs().sum(-1).ne(0)
            assert touched[world, receiver]
            assert not touched[torch.arange(4) != world].any()
            allowed = reach[world, receiver] if crosses else itself[receiver]
            assert not touched[world][~allowed].any()
            others = allowed & ~itself[receiver]
            assert bool(touched[world][others].any()) == bool(others.any())


def rounds_reach_as_many_hops_and_no_further(comm: Comm) -> None:
    """Along a line of robots, each in contact with the next; seen by what moves, not gradients."""
    length = comm.rounds + 3
    place = torch.arange(length)
    rank = (place - place[:, None]).abs().mul(2).add(place > place[:, None]).argsort(-1)
    live = (place - place[:, None]).abs() == 1
    feature = draw(n_agents=length)[0]
    before = comm(feature, live, rank.argsort(-1))[0]
    for sender in range(length):
        moved = feature.clone()
        moved[sender] += 1
        changed = (comm(moved, live, rank.argsort(-1))[0] != before).any(-1)
        one_is_heard = getattr(comm, "places", None) == 1  # of two neighbours in a line
        if one_is_heard or gated(comm):
            assert not changed[(place - sender).abs() > comm.rounds].any()
        else:
            assert torch.equal(changed, (place - sender).abs() <= comm.rounds)


def without_live_edge_the_others_may_be_anyone_or_missing(comm: Comm) -> None:
    feature, live, rank = draw(3, n_agents=4, share=0.0)
    alone = comm(feature[:, :1], live[:, :1, :1], rank[:, :1, :1])[0]
    torch.testing.assert_close(comm(feature, live, rank)[0][:, :1], alone)


def a_batch_is_its_worlds_one_by_one(comm: Comm) -> None:
    inputs = draw(5, n_agents=3)
    together = comm(*inputs)
    for world in range(5):
        for mine, theirs in zip(together[:4], comm(*(x[world] for x in inputs))[:4], strict=True):
            torch.testing.assert_close(mine[world], theirs)


def bits_are_those_of_the_numbers_sent(comm: Comm) -> None:
    feature, live, rank = draw(4, n_agents=5)
    _, message, edges, bits = comm(feature, live, rank)[:4]
    numbers = getattr(comm, "observed", message.shape[-1])
    neighbours = live.sum(-1, keepdim=True).to(bits.dtype)
    if gated(comm):
        neighbours = neighbours * message.ne(0).any(-1, keepdim=True)
        assert 0 < neighbours.sum() < live.sum()  # some speak
    assert torch.equal(edges, neighbours.expand(edges.shape))
    assert torch.equal(bits, comm.bits_per_number * numbers * neighbours)


def what_a_robot_sends_depends_on_nobody_out_of_reach(comm: Comm) -> None:
    feature, live, rank = draw(6, n_agents=5, share=0.3)
    before = comm(feature, live, rank)[1]
    for robot in range(5):
        moved = feature.clone()
        moved[:, robot] += 1
        same = ~within(live, max(0, comm.rounds - 1))[:, :, robot]
        assert torch.equal(comm(moved, live, rank)[1][same], before[same])


def robots_out_of_reach_may_be_added_anywhere(comm: Comm) -> None:
    feature, live, rank = draw(3, n_agents=5, share=0.7)
    live[:, 2], live[:, :, 2] = False, False
    kept = torch.tensor([0, 1, 3, 4])
    fewer = rank[:, kept][..., kept].argsort(-1).argsort(-1)
    result = comm(feature[:, kept], live[:, kept][..., kept], fewer)
    for mine, theirs in zip(comm(feature, live, rank)[:4], result[:4], strict=True):
        torch.testing.assert_close(mine[:, kept], theirs)


CONTRACT: list[Callable[[Comm], None]] = [
    shapes,
    relabelling_the_robots_relabels_the_result,
    a_dead_edge_has_no_influence_not_even_nan_and_no_gradient,
    gradient_crosses_exactly_the_edges_within_the_rounds,
    rounds_reach_as_many_hops_and_no_further,
    without_live_edge_the_others_may_be_anyone_or_missing,
    a_batch_is_its_worlds_one_by_one,
    bits_are_those_of_the_numbers_sent,
    what_a_robot_sends_depends_on_nobody_out_of_reach,
]
