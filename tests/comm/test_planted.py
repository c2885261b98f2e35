"""Planted defects: the contract and the equations refuse schemes that are nearly right."""

import re

import pytest
import torch
from torch import nn

from marl_clean.comm.commnet import CommNet
from marl_clean.comm.dgn import Dgn
from marl_clean.comm.plan import Plan
from marl_clean.comm.tarmac import TarMac
from marl_clean.testing import ContractBroken, check_comm, comm
from marl_clean.testing._broken import Clause, verify
from marl_clean.testing._graphs import within
from marl_clean.testing._levels import maker
from tests.comm import equations
from tests.families import family


class LeakingMean(CommNet):
    """Masks by multiplication with 0."""

    def average(self, hidden, adjacency):
        live = adjacency.to(hidden.dtype)
        return live @ hidden / adjacency.sum(-1, keepdim=True).clamp(min=1)


class SilentCounted(CommNet):
    """Says `live` and divides by all others."""

    def average(self, hidden, adjacency):
        return super().average(hidden, adjacency) * (
            adjacency.sum(-1, keepdim=True) / max(1, adjacency.shape[-1] - 1)
        )


class ItselfHeard(CommNet):
    """The mean counts the robot itself."""

    def average(self, hidden, adjacency):
        itself = torch.eye(adjacency.shape[-1], dtype=torch.bool)
        return super().average(hidden, adjacency | itself)


class Unscaled(TarMac):
    """Leaves sqrt(d_key) out."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.scale = 1.0


class EveryoneHeard(TarMac):
    """Attends to dead edges."""

    def listen(self, state, heard, live, senders, round_index):
        return super().listen(state, heard, senders.distance_rank > 0, senders, round_index)


class Seer(TarMac):
    """Knows where everybody is, in contact or not."""

    places = True

    def _audible(self, senders, live, heard):
        return senders

    def listen(self, state, heard, live, senders, round_index):
        state = super().listen(state, heard, live, senders, round_index)
        return state + senders.offset.sum((-1, -2)).unsqueeze(-1)


class OneRoundPaid(Dgn):
    """Charges for the first round only."""

    def numbers(self, round_index):
        return super().numbers(round_index) if round_index == 0 else 0


class ByNumber(Plan):
    """Orders the neighbours by their numbers instead of their distance."""

    def listen(self, state, heard, live, senders, round_index):
        number = torch.arange(state.shape[-2]).expand(senders.distance_rank.shape)
        by_number = senders._replace(distance_rank=number.contiguous())
        return super().listen(state, heard, live, by_number, round_index)


class FarOff(CommNet):
    """Hears whom its neighbours hear in the same round."""

    def average(self, hidden, adjacency):
        return super().average(hidden, within(adjacency, 2))


class Cheap(CommNet):
    """Sends floats at the price of bits."""

    bits_per_number = 1


class Secretive(CommNet):
    """Detaches what it sends and does not say so."""

    def speak(self, state, round_index):
        return super().speak(state, round_index).detach()


class InAdvance(CommNet):
    """Tells of everybody at once."""

    def begin(self, feature):
        skip, hidden = super().begin(feature)
        return skip, hidden + hidden.mean(-2, keepdim=True)


class OverWorlds(CommNet):
    """Takes all worlds together."""

    def end(self, state):
        hidden = super().end(state)
        return hidden - hidden.mean() if hidden.ndim == 3 else hidden


class Idle(CommNet):
    """Has weights that do nothing."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.idle = nn.Linear(2, 2)


class Wide(CommNet):
    """Says that it gives more than it does."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.out_features += 1


class Inattentive(Dgn):
    """Reports attention to everybody."""

    def attention(self, state):
        return torch.full_like(super().attention(state), 0.1)


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


@family(
    ("wrong", "clause", "broken"),
    [
        (
            LeakingMean,
            comm.a_dead_edge_has_no_influence_not_even_nan_and_no_gradient,
            "NaN of robot 0 crosses a dead edge to",
        ),
        (
            EveryoneHeard,
            comm.a_dead_edge_has_no_influence_not_even_nan_and_no_gradient,
            "a gradient of .* crosses dead edges to robot 0",
        ),
        (
            Seer,
            comm.an_offset_over_a_dead_edge_has_no_influence,
            "feature depends on where robots out of contact are: at",
        ),
        (
            EveryoneHeard,
            comm.gradient_crosses_exactly_the_edges_within_the_rounds,
            "reaches robots .*, not within its rounds of live edges",
        ),
        (
            EveryoneHeard,
            comm.without_live_edge_the_others_may_be_anyone_or_missing,
            "with no live edge, robot 0 of 4 has other features than alone: at",
        ),
        (
            SilentCounted,
            comm.robots_out_of_reach_change_nothing_unless_it_dilutes,
            "without robot 2, which no other reaches, it has another feature: at",
        ),
        (
            FarOff,
            comm.rounds_reach_as_many_hops_and_no_further,
            "crosses 2 edges in 1 rounds",
        ),
        (
            OneRoundPaid,
            comm.bits_are_those_of_the_numbers_sent,
            "round 1 sends 8 numbers and pays for 0",
        ),
        (
            ByNumber,
            comm.relabelling_the_robots_relabels_the_result,
            r"robots renumbered as \[2, 0, 1\] it has another feature: at",
        ),
        (
            Cheap,
            comm.bits_are_those_of_the_numbers_sent,
            "different values in messages of 1 bits a number",
        ),
        (
            Secretive,
            comm.gradient_crosses_exactly_the_edges_within_the_rounds,
            "reaches none of",
        ),
        (
            InAdvance,
            comm.what_a_robot_sends_depends_on_nobody_out_of_reach,
            "in a message, a feature of robot 0 crosses a dead edge to",
        ),
        (
            OverWorlds,
            comm.a_batch_equals_each_world_alone,
            "feature of world 0 of 5 differs alone: at",
        ),
        (Idle, comm.every_weight_learns, "idle.weight gets no gradient"),
        (Wide, comm.shapes, r"feature is \[1, 8\], not \[1, 9\]"),
        (
            Inattentive,
            comm.attention_is_paid_over_live_edges,
            "attention of .* falls on a dead edge",
        ),
    ],
    fast=5,
)
def test_the_contract_refuses(wrong: type, clause: Clause, broken: str) -> None:
    """By the clause that it breaks, and by the contract as a whole."""
    settings = SETTINGS[wrong.__base__]
    for clauses in ([clause], comm.CLAUSES):
        with pytest.raises(ContractBroken) as caught:
            verify("planted", clauses, maker("comm", wrong, settings))
        if clauses == [clause]:
            assert re.search(broken, str(caught.value))
    with pytest.raises(ContractBroken, match=f"^comm={wrong.__name__} "):
        check_comm(wrong, **settings)


@pytest.mark.parametrize("wrong", [SilentCounted, ItselfHeard, FarOff])
def test_the_equation_refuses_a_wrong_mean(wrong: type[CommNet]) -> None:
    with pytest.raises(ContractBroken):
        equations.commnet("live", kind=wrong)


def test_the_equation_refuses_a_wrong_scale() -> None:
    with pytest.raises(ContractBroken):
        equations.tarmac(kind=Unscaled)
