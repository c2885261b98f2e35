"""Every level of conf/comm, and its variants, holds the contract of communication schemes."""

from collections.abc import Callable

import pytest
import torch

from marl_clean.comm.base import Comm
from marl_clean.comm.commnet import CommNet
from tests.comm.contract import (
    CONTRACT,
    DILUTED,
    LEVELS,
    VARIANTS,
    draw,
    make,
    robots_out_of_reach_may_be_added_anywhere,
)

WITH_WEIGHTS = [level for level, _ in LEVELS if list(make(level).parameters())]


def name_of(value) -> str:
    if callable(value):
        return value.__name__
    level, changes = value
    return " ".join([level, *(f"{key}={change}" for key, change in changes.items())])


@pytest.mark.parametrize("check", CONTRACT, ids=name_of)
@pytest.mark.parametrize("variant", VARIANTS + DILUTED, ids=name_of)
def test_the_contract(variant: tuple[str, dict], check: Callable[[Comm], None]) -> None:
    check(make(variant[0], **variant[1]))


@pytest.mark.parametrize("variant", VARIANTS, ids=name_of)
def test_robots_out_of_reach_may_be_added_anywhere(variant: tuple[str, dict]) -> None:
    robots_out_of_reach_may_be_added_anywhere(make(variant[0], **variant[1]))


@pytest.mark.parametrize("variant", DILUTED, ids=name_of)
def test_robots_out_of_reach_dilute_where_all_others_divide(variant: tuple[str, dict]) -> None:
    comm = make(variant[0], **variant[1])
    assert isinstance(comm, CommNet)
    with pytest.raises(AssertionError):
        robots_out_of_reach_may_be_added_anywhere(comm)
    hidden, live, _ = draw(3, n_agents=5, share=0.7)
    live[:, 2], live[:, :, 2] = False, False
    kept = torch.tensor([0, 1, 3, 4])
    fewer = comm.mean(hidden[:, kept], live[:, kept][..., kept])
    torch.testing.assert_close(comm.mean(hidden, live)[:, kept], fewer * 3 / 4)


def test_the_zeroed_twin_has_the_parameters_of_plan() -> None:
    for combine in ("ordered", "sum"):
        plan, zeroed = make("plan", combine=combine), make("zeroed", combine=combine)
        mine, theirs = zeroed.state_dict(), plan.state_dict()
        assert list(mine) == list(theirs)
        assert all(torch.equal(mine[name], theirs[name]) for name in mine)
        feature, live, rank = draw(4, n_agents=4)
        nobody = torch.zeros_like(live)
        expected = plan(feature, nobody, rank)[0]
        assert torch.equal(zeroed(feature, live, rank)[0], expected)
        assert not torch.equal(plan(feature, live, rank)[0], expected)


@pytest.mark.parametrize("level", WITH_WEIGHTS)
def test_every_weight_gets_a_gradient(level: str) -> None:
    comm = make(level).train()
    comm(*draw(4, n_agents=4))[0].sum().backward()
    assert all(weight.grad is not None for weight in comm.parameters())


@pytest.mark.parametrize("level", ["full_state", "commnet", "tarmac", "dgn", "ic3net"])
def test_detached_messages_change_gradients_only(level: str) -> None:
    inputs = draw(4, n_agents=4)
    attached, detached = make(level), make(level, detach=True)
    for mine, theirs in zip(attached(*inputs)[:4], detached(*inputs)[:4], strict=True):
        assert torch.equal(mine, theirs)
    detached.train()(*inputs)[0].sum().backward()
    assert all(weight.grad is not None for weight in detached.parameters())
