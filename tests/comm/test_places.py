"""Where senders are, and how what is heard joins: equations in plain loops, and planted defects."""

from typing import Any

import pytest
import torch
from torch import Tensor

from marl_clean.comm._join import Join
from marl_clean.comm.base import Comm, Hearing
from marl_clean.comm.plan import Plan
from marl_clean.comm.tarmac import TarMac
from marl_clean.errors import BadInput
from marl_clean.testing import ContractBroken, check_comm, comm
from marl_clean.testing._broken import Clause, verify
from marl_clean.testing._levels import maker
from tests.comm.contract import draw, make
from tests.comm.test_planted import SETTINGS


def place(offset: Tensor) -> Tensor:
    row, col = offset.tolist()
    return torch.tensor([row, col, abs(row), abs(col)], dtype=torch.float64) / 10


def heard_by(robot: int, live: Tensor, offset: Tensor) -> list[tuple[int, Tensor]]:
    return [(j, place(offset[robot, j])) for j in live[robot].nonzero().flatten().tolist()]


def plan(scheme: Any, h: Tensor, live: Tensor, offset: Tensor, i: int) -> Tensor:
    received = [
        scheme.received(torch.cat([scheme.message(h[j]), e])) for j, e in heard_by(i, live, offset)
    ]
    total = sum(received, torch.zeros(64, dtype=torch.float64))
    return scheme.join(torch.cat([scheme.own(h[i]), total]))


def commnet(scheme: Any, h: Tensor, live: Tensor, offset: Tensor, i: int) -> Tensor:
    skip = scheme.skip(h)
    received = [torch.cat([skip[j].tanh(), e]) for j, e in heard_by(i, live, offset)]
    mean = sum(received, torch.zeros(132, dtype=torch.float64)) / max(1, len(received))
    return (skip[i] + scheme.own[0](skip[i].tanh()) + scheme.heard[0](mean)).tanh()


def ic3net(scheme: Any, h: Tensor, live: Tensor, offset: Tensor, i: int) -> Tensor:
    skip = scheme.skip(h)
    speaks = scheme.speaks(skip.tanh())
    received = [speaks[j] * torch.cat([skip[j].tanh(), e]) for j, e in heard_by(i, live, offset)]
    mean = sum(received, torch.zeros(132, dtype=torch.float64)) / (len(h) - 1)
    return (skip[i] + scheme.own[0](skip[i].tanh()) + scheme.heard[0](mean)).tanh()


def tarmac(scheme: Any, h: Tensor, live: Tensor, offset: Tensor, i: int) -> Tensor:
    signatures = [scheme.message(h[j]) + scheme.place(e) for j, e in heard_by(i, live, offset)]
    c = torch.zeros(32, dtype=torch.float64)
    if signatures:
        score = torch.stack([scheme.query(h[i]) @ kv[:16] / 4 for kv in signatures])
        c = sum((a * kv[16:] for a, kv in zip(score.softmax(0), signatures, strict=True)), c)
    return scheme.join(torch.cat([h[i], c])).tanh()


def dgn(scheme: Any, h: Tensor, live: Tensor, offset: Tensor, i: int) -> Tensor:
    """Its one round; keys and values of a head are its part of 2 d numbers."""
    key_and_value, to_place = scheme.key_and_value[0], scheme.place[0]
    near = [*heard_by(i, live, offset), (i, torch.zeros(4, dtype=torch.float64))]
    pairs = [(key_and_value(h[j]) + to_place(e)).view(4, 32) for j, e in near]
    query, c = scheme.query[0](h[i]).view(4, 16), []
    for head in range(4):
        score = torch.stack([query[head] @ kv[head, :16] / 4 for kv in pairs])
        c.append(sum(a * kv[head, 16:] for a, kv in zip(score.softmax(0), pairs, strict=True)))
    return torch.cat([h[i], scheme.join[0](torch.cat(c))])


@pytest.mark.parametrize(
    ("equation", "settings"),
    [
        (plan, {"combine": "sum"}),
        (commnet, {"rounds": 1}),
        (ic3net, {}),
        (tarmac, {}),
        (dgn, {"rounds": 1}),
    ],
)
def test_the_equation_with_places(equation, settings: dict[str, Any]) -> None:
    scheme = make(equation.__name__, places=True, **settings)
    feature, live, senders = draw(n_agents=4, share=0.7, seed=2)
    result = scheme(feature, live, senders).feature
    for i in range(4):
        expected = equation(scheme, feature, live, senders.offset, i)
        torch.testing.assert_close(result[i], expected)


@pytest.mark.parametrize("level", ["plan", "full_state", "dial"])
def test_ordered_with_one_slot_and_one_neighbour_is_the_sum(level: str) -> None:
    """Where both are the same thing, so that the nearest's place is its own and not another's."""
    settings = {"places": True, "max_neighbours": 1}
    nearest, added = make(level, **settings), make(level, combine="sum", **settings)
    feature, live, senders = draw(8, n_agents=4, share=0.9)
    live = live & (senders.distance_rank == 1)
    results = [each(feature, live, senders).feature for each in (nearest, added)]
    torch.testing.assert_close(*results)


@pytest.mark.parametrize("join", ["residual", "gated"])
def test_joined_features_are_the_equation(join: str) -> None:
    plain, joining = make("commnet"), make("commnet", join=join)
    joining.load_state_dict({**joining.state_dict(), **plain.state_dict()})
    feature, live, senders = draw(4, n_agents=4, share=0.4)
    given = plain(feature, live, senders).feature
    if join == "residual":
        expected = feature + given @ joining.joined.added.weight.T
    else:
        cell, (f, s) = joining.joined.gate, (x.flatten(0, 1) for x in (feature, given))
        expected = cell(s, f).view_as(feature)
    expected = torch.where(live.any(-1, keepdim=True), expected, feature)
    torch.testing.assert_close(joining(feature, live, senders).feature, expected)


class Transposed(TarMac):
    """Takes for the offset from i to j that from j to i."""

    def _audible(self, senders, live, heard):
        swapped = senders._replace(offset=senders.offset.transpose(-2, -3))
        return super()._audible(swapped, live, heard)


class RowsOnly(TarMac):
    """Forgets the columns."""

    def _audible(self, senders, live, heard):
        audible = super()._audible(senders, live, heard)
        return audible._replace(offset=audible.offset * torch.tensor([1.0, 0.0]))


class Scattered(TarMac):
    """Tells everybody where the heard are, those who do not hear them too."""

    def end(self, state):
        return state + state[..., :1, :]


class Placeless(Plan):
    """Takes places as a setting, and makes nothing of them."""

    def listen(self, state, heard, live, senders, round_index):
        nowhere = torch.zeros_like(senders.offset)
        return super().listen(state, heard, live, senders._replace(offset=nowhere), round_index)


class Always(Join):
    def forward(self, before, given, hears):
        return super().forward(before, given, torch.ones_like(hears))


class AlwaysJoined(Plan):
    """Joins features with what is made of them, heard or not."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.joined = Always("residual", self.out_features, SETTINGS[Plan]["hidden"])


IN_PLACES = Hearing(places=True)


@pytest.mark.parametrize(
    ("wrong", "hearing", "clause", "broken"),
    [
        (
            Transposed,
            IN_PLACES,
            comm.where_a_sender_is_reaches_its_hearer,
            "the row of its sender does not reach robot 0",
        ),
        (
            RowsOnly,
            IN_PLACES,
            comm.where_a_sender_is_reaches_its_hearer,
            "the col of its sender does not reach robot 0",
        ),
        (
            Scattered,
            IN_PLACES,
            comm.where_a_sender_is_reaches_its_hearer,
            "the row of robot 1, which robot 0 hears, reaches",
        ),
        (
            Placeless,
            IN_PLACES,
            comm.turning_the_house_matters_only_with_places,
            "places is True, but 1 quarter turns change nothing",
        ),
        (
            AlwaysJoined,
            Hearing(join="residual"),
            comm.who_hears_nothing_keeps_its_features_to_the_bit,
            "a robot that hears nothing has other features than before: at",
        ),
    ],
)
def test_the_contract_refuses(
    wrong: type[Comm], hearing: Hearing, clause: Clause, broken: str
) -> None:
    settings = {**SETTINGS[wrong.__base__], "hearing": hearing}
    with pytest.raises(ContractBroken, match=broken):
        verify("planted", [clause], maker("comm", wrong, settings))


def test_a_scheme_without_places_refuses_them_in_one_line() -> None:
    with pytest.raises(BadInput, match="^comm.places: no such key; there are none here$"):
        check_comm("none", places=True)
