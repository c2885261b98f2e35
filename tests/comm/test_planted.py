"""Planted defects: the contract and the equations refuse schemes that are nearly right."""

from collections.abc import Callable

import pytest
import torch

from marl_clean.comm.commnet import CommNet
from marl_clean.comm.dgn import Dgn
from marl_clean.comm.plan import Plan
from marl_clean.comm.tarmac import TarMac
from tests.comm import contract, equations
from tests.comm.contract import FEATURES


class LeakingMean(CommNet):
    """Masks by multiplication with 0."""

    def mean(self, hidden, adjacency):
        live = adjacency.to(hidden.dtype)
        return live @ hidden / adjacency.sum(-1, keepdim=True).clamp(min=1)


class SilentCounted(CommNet):
    """Says `live` and divides by all others."""

    def mean(self, hidden, adjacency):
        return super().mean(hidden, adjacency) * (
            adjacency.sum(-1, keepdim=True) / max(1, adjacency.shape[-1] - 1)
        )


class ItselfHeard(CommNet):
    """The mean counts the robot itself."""

    def mean(self, hidden, adjacency):
        itself = torch.eye(adjacency.shape[-1], dtype=torch.bool)
        return super().mean(hidden, adjacency | itself)


class Unscaled(TarMac):
    """Leaves sqrt(d_key) out."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.scale = 1.0


class EveryoneHeard(TarMac):
    """Attends to dead edges."""

    def listen(self, state, heard, live, distance_rank, round_index):
        return super().listen(state, heard, distance_rank > 0, distance_rank, round_index)


class OneRoundPaid(Dgn):
    """Charges for the first round only."""

    def numbers(self, round_index):
        return super().numbers(round_index) if round_index == 0 else 0


class ByNumber(Plan):
    """Orders the neighbours by their numbers instead of their distance."""

    def listen(self, state, heard, live, distance_rank, round_index):
        number = torch.arange(state.shape[-2]).expand(distance_rank.shape)
        return super().listen(state, heard, live, number.contiguous(), round_index)


class FarOff(CommNet):
    """Hears whom its neighbours hear in the same round."""

    def mean(self, hidden, adjacency):
        return super().mean(hidden, contract.within(adjacency, 2))


SETTINGS = {
    CommNet: {"hidden": 8, "rounds": 1, "divisor": "live", "detach": False},
    TarMac: {
        "message_dim": 8,
        "key_dim": 4,
        "rounds": 1,
        "self_included": False,
        "detach": False,
    },
    Dgn: {"hidden": 8, "heads": 2, "head_dim": 4, "rounds": 2, "detach": False, "pull": 0.0},
    Plan: {
        "message_dim": 8,
        "hidden": 8,
        "received": 8,
        "combine": "ordered",
        "max_neighbours": 3,
    },
}


@pytest.mark.parametrize(
    ("wrong", "check"),
    [
        (LeakingMean, contract.a_dead_edge_has_no_influence_not_even_nan_and_no_gradient),
        (EveryoneHeard, contract.a_dead_edge_has_no_influence_not_even_nan_and_no_gradient),
        (EveryoneHeard, contract.gradient_crosses_exactly_the_edges_within_the_rounds),
        (EveryoneHeard, contract.without_live_edge_the_others_may_be_anyone_or_missing),
        (SilentCounted, contract.robots_out_of_reach_may_be_added_anywhere),
        (FarOff, contract.rounds_reach_as_many_hops_and_no_further),
        (OneRoundPaid, contract.bits_are_those_of_the_numbers_sent),
        (ByNumber, contract.relabelling_the_robots_relabels_the_result),
    ],
)
def test_the_contract_refuses(wrong: type, check: Callable) -> None:
    torch.manual_seed(0)
    comm = wrong(FEATURES, **SETTINGS[wrong.__base__]).double()
    with pytest.raises(AssertionError):
        check(comm)


@pytest.mark.parametrize("wrong", [SilentCounted, ItselfHeard, FarOff])
def test_the_equation_refuses_a_wrong_mean(wrong: type[CommNet]) -> None:
    with pytest.raises(AssertionError):
        equations.commnet("live", kind=wrong)


def test_the_equation_refuses_a_wrong_scale() -> None:
    with pytest.raises(AssertionError):
        equations.tarmac(kind=Unscaled)
