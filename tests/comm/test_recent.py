"""The recent schemes are their equations, worked out robot by robot in plain loops."""

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders
from marl_clean.comm.dcc import Dcc
from marl_clean.comm.expocomm import ExpoComm
from marl_clean.comm.magic import Magic
from marl_clean.comm.masia import Masia
from marl_clean.errors import BadInput
from marl_clean.testing import ContractBroken, comm
from marl_clean.testing._broken import Clause, require_close, require_equal, verify
from marl_clean.testing._levels import maker
from tests.comm.contract import FEATURES, draw, make
from tests.comm.test_places import place

WORLDS, N_AGENTS = 4, 5
Edges = set[tuple[int, int]]


def leaky(x: Tensor) -> Tensor:
    return torch.where(x > 0, x, 0.2 * x)


def elu(x: Tensor) -> Tensor:
    return torch.where(x > 0, x, x.exp() - 1)


def attended(layer: Any, x: list[Tensor], i: int, others: list[int], added: dict) -> Tensor:
    """A robot's graph attention over others and itself; `added`: P e_ij of each other."""
    heads, parts = layer.heads, []
    y = [layer.project.weight @ each for each in x]
    for head in range(heads):
        width = len(y[0]) // heads
        part = slice(head * width, (head + 1) * width)
        ask, of = layer.hearer[head, 0], layer.sender[head, 0]
        values = [y[j][part] + added.get(j, torch.zeros_like(y[j]))[part] for j in [*others, i]]
        score = torch.stack([leaky(ask @ y[i][part] + of @ value) for value in values])
        weight = score.exp() / score.exp().sum()
        parts.append(sum(w * value for w, value in zip(weight, values, strict=True)))
    joined = torch.stack(parts).mean(0) if layer.mean else torch.cat(parts)
    return joined + layer.bias


def magic(scheme: Any, h: Tensor, live: Tensor, offset: Tensor) -> tuple[Tensor, list[Edges]]:
    robots = range(len(h))
    contact = [live[i].nonzero().flatten().tolist() for i in robots]
    e = {(i, j): place(offset[i, j]) for i in robots for j in contact[i]}

    def added(layer: int, i: int) -> dict[int, Tensor]:
        return {j: scheme.place[layer](e[i, j]) for j in contact[i]} if scheme.places else {}

    u = [scheme.signal(h[i]) for i in robots]
    s = [attended(scheme.overview, u, i, contact[i], added(0, i)) for i in robots]
    opened: list[Edges] = []
    for schedule in scheme.schedules:
        logits = {
            (i, j): schedule.logit(torch.cat([s[i], s[j], *([e[i, j]] if scheme.places else [])]))
            for i, j in e
        }
        opened.append({edge for edge, logit in logits.items() if logit > 0})
    c = [scheme.message(h[i]) for i in robots]
    for layer, edges in enumerate(opened):
        heard = [[j for j in contact[i] if (i, j) in edges] for i in robots]
        c = [
            attended(scheme.processors[layer], c, i, heard[i], added(layer + 1, i)) for i in robots
        ]
        c = [elu(each) for each in c] if layer == 0 else c
    return torch.stack([torch.cat([h[i], c[i]]) for i in robots]), [set(e), set(e), *opened]


def exchanged(layer: Any, z: list[Tensor], i: int, others: list[int], offset: Tensor) -> Tensor:
    if not others:
        return z[i]
    query = layer.query(layer.norm(z[i]))
    pairs = [
        layer.key_and_value(layer.message(layer.norm(z[j]))) + layer.place(place(offset[i, j]))
        for j in others
    ]
    parts, width = [], len(query) // layer.heads
    for head in range(layer.heads):
        key_and_value = [pair[2 * head * width : 2 * (head + 1) * width] for pair in pairs]
        q = query[head * width : (head + 1) * width]
        score = torch.stack([q @ kv[:width] / width**0.5 for kv in key_and_value]).softmax(0)
        parts.append(sum(a * kv[width:] for a, kv in zip(score, key_and_value, strict=True)))
    return layer.update(layer.together(torch.cat(parts)), z[i])


def dcc(scheme: Any, h: Tensor, live: Tensor, offset: Tensor) -> tuple[Tensor, list[Edges]]:
    robots = range(len(h))
    seen = {
        (i, j): scheme.presence(place(offset[i, j])) for i in robots for j in robots if live[i, j]
    }
    z = [h[i] + sum((p for (a, _), p in seen.items() if a == i), 0 * h[i]) for i in robots]
    asks = {(i, j) for (i, j), p in seen.items() if head(z[i] - p).argmax() != head(z[i]).argmax()}
    requests, replies = {(j, i) for i, j in asks}, asks
    for layer, edges in zip(scheme.exchanges, (requests, replies), strict=True):
        heard = [sorted(j for a, j in edges if a == i) for i in robots]
        z = [exchanged(layer, z, i, heard[i], offset) for i in robots]
    return torch.stack(z), [requests, replies]


def head(feature: Tensor) -> Tensor:
    """Four action values, whatever the features."""
    return feature @ torch.linspace(-1, 1, 4 * FEATURES, dtype=torch.float64).sin().view(-1, 4)


def expocomm(
    scheme: Any, h: Tensor, live: Tensor, offset: Tensor, hidden: Tensor, rank: Tensor
) -> tuple[Tensor, list[Edges], Tensor]:
    robots, edges, remembered = range(len(h)), set(), []
    for j in robots:
        nearest = sorted(live[j].nonzero().flatten().tolist(), key=lambda i: int(rank[j, i]))
        powers = [2**k for k in range(5) if 2**k <= len(nearest)]
        if scheme.peers == "one" and powers:
            powers = [powers[int(hidden[j, -1]) % len(powers)]]
        edges |= {(nearest[power - 1], j) for power in powers}
    message = hidden[:, :-1]
    for i in robots:
        heard = sorted(j for a, j in edges if a == i)
        taken = []
        for j in heard or [i]:
            pair = scheme.own(h[i]) + scheme.others(message[j])
            if scheme.places and heard:
                pair = pair + scheme.place(place(offset[i, j]))
            taken.append(pair.relu())
        remembered.append(scheme.update(torch.stack(taken).mean(0), message[i]))
    after = torch.stack(remembered)
    return torch.cat([h, after], -1), [edges], torch.cat([after, hidden[:, -1:] + 1], -1)


def masia(scheme: Any, h: Tensor, live: Tensor, offset: Tensor) -> tuple[Tensor, list[Edges]]:
    robots = range(len(h))
    message = [scheme.message(h[i]) for i in robots]
    d, represented = scheme.sizes[0], []
    for i in robots:
        members = [*live[i].nonzero().flatten().tolist(), i]
        parts = []
        for a in members:
            part = scheme.parts(message[a])
            parts.append(part + scheme.place(place(offset[i, a])) if scheme.places else part)
        attended = []
        for asks in parts:
            score = torch.stack([asks[:d] @ part[d : 2 * d] / d**0.5 for part in parts]).softmax(0)
            y = sum(share * part[2 * d :] for share, part in zip(score, parts, strict=True))
            attended.append(y.relu())
        represented.append(scheme.represent(torch.stack(attended).mean(0)))
    z = torch.stack(represented)
    edges = {(i, j) for i in robots for j in live[i].nonzero().flatten().tolist()}
    return torch.cat([h, scheme.focus(h).sigmoid() * z], -1), [edges]


def requires(talk: Any, world: int, feature: Tensor, edges: list[Edges], scheme: Comm) -> None:
    require_close(talk.feature[world], feature, "not the equation")
    for sender in range(N_AGENTS):
        counts = [sum(j == sender for _, j in of_round) for of_round in edges]
        require_equal(talk.edges[world, sender], torch.tensor(counts).double(), "edges")
        bits = 32 * sum(n * d for n, d in zip(counts, scheme.message_dims, strict=True))
        require_equal(talk.bits[world, sender], torch.tensor([bits]).double(), "bits")


def varied(scheme: Magic) -> Magic:
    """With schedules that open some edges and shut others."""
    for schedule in scheme.schedules:
        nn.init.normal_(schedule.logit[0].weight)
        nn.init.normal_(schedule.logit[2].weight)
    return scheme


@pytest.mark.parametrize("places", [False, True])
@torch.no_grad()
def test_magic(places: bool, kind: type[Magic] = Magic) -> None:
    torch.manual_seed(1)
    scheme = varied(make("magic", places=places))
    scheme.__class__ = kind
    feature, live, senders = draw(WORLDS, n_agents=N_AGENTS)
    talk = scheme(feature, live, senders)
    shares = []
    for world in range(WORLDS):
        expected, edges = magic(scheme, feature[world], live[world], senders.offset[world])
        requires(talk, world, expected, edges, scheme)
        shares += [len(edges[2]) / len(edges[0]), len(edges[3]) / len(edges[0])]
    assert min(shares) < 1 and max(shares) > 0


@torch.no_grad()
def test_dcc(kind: type[Dcc] = Dcc) -> None:
    scheme = make("dcc")
    scheme.__class__ = kind
    feature, live, senders = draw(WORLDS, n_agents=N_AGENTS)
    talk = scheme(feature, live, senders, None, None, head)
    asked = 0
    for world in range(WORLDS):
        expected, edges = dcc(scheme, feature[world], live[world], senders.offset[world])
        requires(talk, world, expected, edges, scheme)
        asked += len(edges[0])
    assert 0 < asked < live.sum()


@pytest.mark.parametrize("peers", ["one", "all"])
@pytest.mark.parametrize("places", [False, True])
@torch.no_grad()
def test_expocomm(places: bool, peers: str, kind: type[ExpoComm] = ExpoComm) -> None:
    scheme = make("expocomm", places=places, peers=peers)
    scheme.__class__ = kind
    hidden = torch.zeros(WORLDS, N_AGENTS, scheme.remembers, dtype=torch.float64)
    for step in range(4):
        feature, live, senders = draw(WORLDS, n_agents=N_AGENTS, share=0.7, seed=step)
        talk = scheme(feature, live, senders, None, hidden)
        for world in range(WORLDS):
            expected, edges, after = expocomm(
                scheme,
                feature[world],
                live[world],
                senders.offset[world],
                hidden[world],
                senders.distance_rank[world],
            )
            requires(talk, world, expected, edges, scheme)
            require_close(talk.hidden[world], after, "not what is carried")
        hidden = talk.hidden


@pytest.mark.parametrize("places", [False, True])
@torch.no_grad()
def test_masia(places: bool, kind: type[Masia] = Masia) -> None:
    scheme = make("masia", places=places)
    scheme.__class__ = kind
    feature, live, senders = draw(WORLDS, n_agents=N_AGENTS)
    talk = scheme(feature, live, senders)
    for world in range(WORLDS):
        expected, edges = masia(scheme, feature[world], live[world], senders.offset[world])
        requires(talk, world, expected, edges, scheme)


def test_dcc_without_places_is_refused() -> None:
    with pytest.raises(BadInput, match=r"^comm\.places: false, but dcc .*; valid: true$"):
        make("dcc", places=False)


class Deaf(Magic):
    """Hears over every edge of which it heard a signal, open or not."""

    def _process(self, state, heard, live, index):
        return super()._process(state, heard, state.live, index)


class Unpaid(Magic):
    """Does not pay for signals."""

    def numbers(self, round_index):
        return 0 if round_index < 2 else super().numbers(round_index)


class FirstSchedule(Magic):
    """Uses the first schedule for both messages."""

    def choose(self, state, round_index):
        return super().choose(state, min(round_index, 2))


class AsksAll(Dcc):
    """Asks everybody."""

    def look(self, feature, scene):
        state = super().look(feature, scene)
        return state._replace(writes=scene.contact)


class RepliesToAll(Dcc):
    """Replies to those it asked, too."""

    def listen(self, state, heard, live, senders, round_index):
        after = super().listen(state, heard, live, senders, round_index)
        return after._replace(writes=live | live.mT)


class ByNumber(ExpoComm):
    """Takes a robot's number for its rank by distance."""

    def look(self, feature, scene):
        number = torch.arange(feature.shape[-2]).expand(scene.contact.shape)
        return super().look(feature, scene._replace(senders=Senders(number)))


class Forgetful(ExpoComm):
    """Sends what it made of this step's features, and remembers nothing."""

    def carry(self, state):
        return torch.zeros_like(super().carry(state))


class FarRank(ExpoComm):
    """Counts robots out of contact, too."""

    def look(self, feature, scene):
        everyone = ~torch.eye(feature.shape[-2], dtype=torch.bool).expand(scene.contact.shape)
        state = super().look(feature, scene._replace(contact=everyone))
        return state._replace(writes=state.writes & scene.contact)


class Unfocused(Masia):
    """Takes all of the representation."""

    def end(self, state):
        return torch.cat([state.feature, state.represented], -1)


class Deafened(Masia):
    """Lets messages attend to those of all robots, heard or not."""

    def listen(self, state, heard, live, senders, round_index):
        everyone = torch.ones_like(live) & ~torch.eye(live.shape[-1], dtype=torch.bool)
        return super().listen(state, heard, everyone, senders, round_index)


@pytest.mark.parametrize(
    ("check", "wrong", "broken"),
    [
        (lambda kind: test_magic(False, kind), Deaf, "not the equation"),
        (lambda kind: test_magic(False, kind), Unpaid, "bits"),
        (lambda kind: test_magic(True, kind), FirstSchedule, "not the equation"),
        (test_dcc, AsksAll, "not the equation"),
        (test_dcc, RepliesToAll, "not the equation|edges"),
        (lambda kind: test_expocomm(False, "all", kind), ByNumber, "not the equation"),
        (lambda kind: test_expocomm(False, "one", kind), Forgetful, "not what is carried"),
        (lambda kind: test_expocomm(False, "all", kind), FarRank, "not the equation|edges"),
        (lambda kind: test_masia(False, kind), Unfocused, "not the equation"),
        (lambda kind: test_masia(False, kind), Deafened, "not the equation"),
    ],
)
def test_the_equations_refuse(check: Any, wrong: type, broken: str) -> None:
    with pytest.raises(ContractBroken, match=broken):
        check(kind=wrong)


MAGIC = {
    "signal_dim": 4,
    "message_dim": 8,
    "heads": 2,
    "head_dim": 4,
    "hidden": 8,
    "temperature": 1.0,
    "detach": False,
}
EXPOCOMM = {"hidden": 8, "peers": "all", "reconstruct": 0.0, "detach": False}


@pytest.mark.parametrize(
    ("wrong", "settings", "clause", "broken"),
    [
        (Unpaid, MAGIC, comm.bits_are_those_of_the_numbers_sent, "sends 4 numbers and pays for 0"),
        (
            Deaf,
            MAGIC,
            comm.nothing_crosses_an_edge_that_a_robot_does_not_choose,
            "NaN in round [23] of robot . crosses a dead edge",
        ),
        (
            ByNumber,
            EXPOCOMM,
            comm.relabelling_the_robots_relabels_the_result,
            r"robots renumbered as .* it has another feature",
        ),
        (
            FarRank,
            EXPOCOMM,
            comm.robots_out_of_reach_change_nothing_unless_it_dilutes,
            "without robot 2, which no other reaches, it has another",
        ),
    ],
)
def test_the_contract_refuses(wrong: type, settings: dict, clause: Clause, broken: str) -> None:
    with pytest.raises(ContractBroken, match=broken):
        verify("planted", [clause], maker("comm", wrong, settings))
