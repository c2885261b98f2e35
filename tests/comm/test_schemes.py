"""What every communication scheme must hold, for every level of conf/comm."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from marl_clean.schema import instantiate

FEATURES = 12
CONF = Path(__file__).parents[2] / "conf" / "comm"
VARIANTS = [(path.stem, {}) for path in sorted(CONF.glob("*.yaml"))] + [
    ("plan", {"combine": "sum"}),
    ("plan", {"max_neighbours": 1}),
]
PER_BATCH = [(), (1,), (5,), (2, 3)]


@pytest.fixture(params=VARIANTS, ids=str)
def comm(request):
    level, changes = request.param
    torch.manual_seed(0)
    section = OmegaConf.merge(OmegaConf.load(CONF / f"{level}.yaml"), changes)
    return instantiate(section, in_features=FEATURES).double()


def draw(*batch: int, n_agents: int, share: float = 0.5, seed: int = 0):
    """Features, a symmetric graph, and the ranks that random places give."""
    generator = torch.Generator().manual_seed(seed)
    rand = torch.rand(*batch, n_agents, n_agents, generator=generator)
    live = (rand < share).triu(1)
    place = torch.rand(*batch, n_agents, 2, generator=generator)
    rank = torch.cdist(place, place).argsort(-1).argsort(-1)
    feature = torch.randn(*batch, n_agents, FEATURES, generator=generator, dtype=torch.float64)
    return feature, live | live.mT, rank


@pytest.mark.parametrize("batch", PER_BATCH)
@pytest.mark.parametrize("n_agents", [1, 2, 5])
def test_shapes(comm, batch, n_agents):
    feature, message, bits = comm(*draw(*batch, n_agents=n_agents))
    assert feature.shape == (*batch, n_agents, comm.out_features)
    assert message.shape[:-1] == (*batch, n_agents)
    assert bits.shape == (*batch, n_agents, 1)


@pytest.mark.parametrize("n_agents", [2, 3, 6])
def test_relabelling_the_robots_relabels_the_result(comm, n_agents):
    feature, live, rank = draw(4, n_agents=n_agents)
    order = torch.randperm(n_agents, generator=torch.Generator().manual_seed(1))
    relabelled = comm(feature[:, order], live[:, order][..., order], rank[:, order][..., order])
    for mine, theirs in zip(comm(feature, live, rank), relabelled, strict=True):
        torch.testing.assert_close(mine[:, order], theirs)


def test_a_dead_edge_has_no_influence_not_even_nan_and_no_gradient(comm):
    feature, live, rank = draw(6, n_agents=4)
    before = comm(feature, live, rank)[0]
    for sender in range(4):
        deaf = ~live[:, :, sender]
        deaf[:, sender] = False
        poisoned = feature.clone()
        poisoned[:, sender] = torch.nan
        assert torch.equal(comm(poisoned, live, rank)[0][deaf], before[deaf])
        inputs = feature.clone().requires_grad_()
        comm(inputs, live, rank)[0][deaf].sum().backward()
        reached = inputs.grad[:, sender][~live[:, sender].any(-1)]
        assert torch.equal(reached, torch.zeros_like(reached))


def test_gradient_crosses_exactly_the_live_edges_heard(comm):
    feature, live, rank = draw(3, n_agents=3, share=0.5)
    feature.requires_grad_()
    joined, message, _ = comm(feature, live, rank)
    for world in range(3):
        for receiver in range(3):
            (grad,) = torch.autograd.grad(joined[world, receiver].sum(), feature, retain_graph=True)
            touched = grad.abs().sum(-1).ne(0)
            others = torch.arange(3) != receiver
            allowed = live[world, receiver]
            assert not touched[world][others & ~allowed].any()
            assert not touched[torch.arange(3) != world].any()
            if message.shape[-1] and allowed.any():
                assert touched[world][allowed].any()


def test_without_live_edge_the_others_may_be_anyone_or_missing(comm):
    feature, live, rank = draw(3, n_agents=4, share=0.0)
    alone = comm(feature[:, :1], live[:, :1, :1], rank[:, :1, :1])[0]
    torch.testing.assert_close(comm(feature, live, rank)[0][:, :1], alone)


def test_robots_out_of_reach_may_be_added_anywhere(comm):
    feature, live, rank = draw(3, n_agents=5, share=0.7)
    live[:, 2], live[:, :, 2] = False, False
    kept = torch.tensor([0, 1, 3, 4])
    fewer = rank[:, kept][..., kept].argsort(-1).argsort(-1)
    result = comm(feature[:, kept], live[:, kept][..., kept], fewer)
    for mine, theirs in zip(comm(feature, live, rank), result, strict=True):
        torch.testing.assert_close(mine[:, kept], theirs)


def test_a_batch_is_its_worlds_one_by_one(comm):
    inputs = draw(5, n_agents=3)
    together = comm(*inputs)
    for world in range(5):
        for mine, theirs in zip(together, comm(*(x[world] for x in inputs)), strict=True):
            torch.testing.assert_close(mine[world], theirs)


def test_bits_are_those_of_the_messages_sent(comm):
    feature, live, rank = draw(4, n_agents=5)
    _, message, bits = comm(feature, live, rank)
    assert torch.equal(bits, 32 * message.shape[-1] * live.sum(-1, keepdim=True).to(bits.dtype))
