"""Products over live edges are what spreading over all pairs gives, and keep to live edges."""

from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from marl_clean.comm._live_edges import meet_live, weigh_live

Product = Callable[[Tensor, Tensor, Tensor], Tensor]
BATCHES = st.sampled_from([(), (1,), (3,), (2, 2)])


def weigh_plainly(weight: Tensor, value: Tensor, live: Tensor) -> Tensor:
    weight = torch.where(live, weight, 0.0).unsqueeze(-1)
    return (weight * torch.where(live.unsqueeze(-1), value.unsqueeze(-3), 0.0)).sum(-2)


def meet_plainly(query: Tensor, key: Tensor, live: Tensor) -> Tensor:
    spread = torch.where(live.unsqueeze(-1), key.unsqueeze(-3), 0.0)
    asked = torch.where(live.unsqueeze(-1), query.unsqueeze(-2), 0.0)
    return (asked * spread).sum(-1)


def drawn(batch: tuple[int, ...], n_agents: int, seed: int) -> tuple[Tensor, ...]:
    """Weights, queries, values, and who hears whom, not both ways alike."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*batch, n_agents, *shape, generator=generator, dtype=torch.float64)

    live = torch.rand(*batch, n_agents, n_agents, generator=generator) < 0.5
    return normal(n_agents), normal(3), normal(3), live


def with_gradients(product: Product, first: Tensor, second: Tensor, live: Tensor, back: Tensor):
    first, second = first.clone().requires_grad_(), second.clone().requires_grad_()
    result = product(first, second, live)
    return result.detach(), *torch.autograd.grad(result, (first, second), back)


@pytest.mark.slow
@settings(deadline=None)
@given(BATCHES, st.integers(1, 6), st.integers(0, 1_000))
def test_they_are_the_plain_ones_and_so_are_their_gradients(batch, n_agents, seed) -> None:
    weight, query, value, live = drawn(batch, n_agents, seed)
    cases = [(weigh_live, weigh_plainly, weight, query), (meet_live, meet_plainly, query, weight)]
    for product, plain, first, back in cases:
        mine = with_gradients(product, first, value, live, back)
        for one, other in zip(mine, with_gradients(plain, first, value, live, back), strict=True):
            torch.testing.assert_close(one, other)


@pytest.mark.slow
@settings(deadline=None)
@given(st.integers(1, 6), st.integers(0, 1_000), st.sampled_from([torch.nan, torch.inf]))
def test_what_is_not_finite_crosses_the_live_edges_and_no_other(n_agents, seed, ill) -> None:
    weight, query, value, live = drawn((2,), n_agents, seed)
    sender = seed % n_agents
    value[:, sender] = ill
    heard = live[:, :, sender]
    assert torch.equal(weigh_live(weight, value, live).isfinite().all(-1), ~heard)
    other = torch.arange(n_agents) != sender
    met = meet_live(query, value, live).isfinite()
    assert torch.equal(met[..., sender], ~heard) and met[..., other].all()


@pytest.mark.slow
@settings(deadline=None)
@given(st.integers(1, 6), st.integers(0, 1_000))
def test_neither_does_it_come_back_over_a_dead_edge(n_agents, seed) -> None:
    """A hearer's gradient that is NaN reaches whom it hears, and the others' is as it was."""
    weight, query, value, live = drawn((2,), n_agents, seed)
    hearer = seed % n_agents
    cases = ((weigh_live, weight, query.clone()), (meet_live, query, weight.clone()))
    for product, first, back in cases:
        _, _, before = with_gradients(product, first, value, live, back)
        back[:, hearer] = torch.nan
        _, _, after = with_gradients(product, first, value, live, back)
        touched = live[:, hearer]
        assert after[touched].isnan().all()
        assert torch.equal(after[~touched], before[~touched])


@pytest.mark.parametrize("product", [weigh_live, meet_live])
def test_they_go_under_vmap_with_gradients(product: Product) -> None:
    weight, query, value, live = drawn((4,), 3, 0)
    first = weight if product is weigh_live else query

    def total(first: Tensor, second: Tensor, live: Tensor) -> Tensor:
        return product(first, second, live).square().sum()

    mapped = torch.vmap(torch.func.grad(total, (0, 1)))(first, value, live)
    for world in range(4):
        alone = torch.func.grad(total, (0, 1))(first[world], value[world], live[world])
        for mine, theirs in zip(mapped, alone, strict=True):
            torch.testing.assert_close(mine[world], theirs)
