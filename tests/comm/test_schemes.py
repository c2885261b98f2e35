"""Every level of conf/comm, and its variants, holds the contract of communication schemes."""

import pytest
import torch

from marl_clean.comm._hidden_states import HiddenStates
from marl_clean.testing._broken import Clause
from marl_clean.testing.comm import CLAUSES, who_hears_nothing_keeps_its_features_to_the_bit
from tests.comm.contract import DILUTED, TALKING, VARIANTS, draw, line, make, maker_of
from tests.families import family


def name_of(value) -> str:
    if callable(value):
        return value.__name__
    level, changes = value
    return " ".join([level, *(f"{key}={change}" for key, change in changes.items())])


@pytest.mark.parametrize("clause", CLAUSES, ids=name_of)
@family("variant", VARIANTS + DILUTED, fast=2, usual=18, ids=name_of)
def test_the_contract(variant: tuple[str, dict], clause: Clause) -> None:
    clause(maker_of(variant[0], **variant[1]))


@pytest.mark.parametrize("variant", VARIANTS + DILUTED, ids=name_of)
def test_everybody_within_the_rounds_is_heard(variant: tuple[str, dict]) -> None:
    """More than the contract asks, of all but those who choose or hear one neighbour of two."""
    comm = make(variant[0], **variant[1])
    length = comm.rounds + 3
    live, rank, hops = line(length)
    feature = draw(n_agents=length)[0]
    before = comm(feature, live, rank)[0]
    if comm.gated or comm.chooses or comm.decodes or variant[1].get("max_neighbours") == 1:
        return
    for sender in range(length):
        moved = feature.clone()
        moved[sender] += 1
        changed = (comm(moved, live, rank)[0] != before).any(-1)
        assert torch.equal(changed, hops[sender] <= comm.rounds)


@pytest.mark.parametrize("variant", DILUTED, ids=name_of)
def test_robots_out_of_reach_dilute_where_all_others_divide(variant: tuple[str, dict]) -> None:
    comm = make(variant[0], **variant[1])
    assert isinstance(comm, HiddenStates)
    hidden, live, _ = draw(3, n_agents=5, share=0.7)
    live[:, 2], live[:, :, 2] = False, False
    kept = torch.tensor([0, 1, 3, 4])
    fewer = comm.average(hidden[:, kept], live[:, kept][..., kept])
    torch.testing.assert_close(comm.average(hidden, live)[:, kept], fewer * 3 / 4)


@pytest.mark.parametrize("join", ["residual", "gated"])
@pytest.mark.parametrize("level", TALKING)
def test_who_hears_nothing_keeps_its_features(level: str, join: str) -> None:
    who_hears_nothing_keeps_its_features_to_the_bit(maker_of(level, join=join))


@pytest.mark.parametrize("level", TALKING)
def test_places_and_join_leave_weights_as_they_were_by_default(level: str) -> None:
    """So that stored weights fit, and training draws what it drew."""
    plain, asked = make(level).state_dict(), make(level, places=True, join="gated").state_dict()
    always = make(level).places  # part of the scheme
    assert always or not any("place" in name for name in plain)
    assert not any("joined" in name for name in plain)
    assert any("joined" in name for name in asked)


def test_some_speak_and_some_do_not() -> None:
    """So that what the contract asks of silence is asked of both."""
    talk = make("ic3net")(*draw(4, n_agents=5))
    assert 0 < talk.message.ne(0).any(-1).sum() < 20


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


@pytest.mark.parametrize("level", ["full_state", "commnet", "tarmac", "dgn", "ic3net"])
def test_detached_messages_change_gradients_only(level: str) -> None:
    inputs = draw(4, n_agents=4)
    attached, detached = make(level), make(level, detach=True)
    for mine, theirs in zip(attached(*inputs)[:4], detached(*inputs)[:4], strict=True):
        assert torch.equal(mine, theirs)
    detached.train()(*inputs)[0].sum().backward()
    assert all(weight.grad is not None for weight in detached.parameters())
