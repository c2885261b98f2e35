"""The schemes' equations with numbers set by hand, worked out in plain Python.

Three robots: 0 and 1 in contact, 0 and 2 too, 1 and 2 not; and a fourth with nobody.
"""

from math import exp, sqrt, tanh

import torch
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders
from marl_clean.comm.commnet import CommNet
from marl_clean.comm.dgn import Dgn
from marl_clean.comm.dial import Dial
from marl_clean.comm.full_state import FullState
from marl_clean.comm.ic3net import Ic3Net
from marl_clean.comm.plan import Plan
from marl_clean.comm.tarmac import TarMac
from marl_clean.testing._broken import require_close, require_equal

Vector = list[float]
Rows = list[Vector]

FEATURE: Rows = [[1.0, -0.5], [0.25, 2.0], [-1.5, 0.75], [0.5, 0.5]]
HEARS = [[1, 2], [0], [0], []]
LIVE = torch.tensor([[0, 1, 1, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], dtype=torch.bool)
RANK = torch.tensor([[0, 2, 1, 3], [1, 0, 2, 3], [1, 2, 0, 3], [1, 2, 3, 0]])  # 2 nearest to 0

A: Rows = [[0.5, -1.0], [0.25, 0.75]]
B: Rows = [[-0.5, 0.25], [1.0, 0.5]]
C: Rows = [[1.5, 0.5], [-0.25, 1.0]]
WIDE: Rows = [[0.5, 0.25, -1.0, 0.75], [-0.25, 1.0, 0.5, 0.25]]
WIDER: Rows = [[0.5, 0.25, -1.0, 0.75, 0.5, -0.5], [-0.25, 1.0, 0.5, 0.25, 2.0, 1.0]]
SHIFT = [0.125, -0.25]


def put(layer: nn.Module, weight: Rows, bias: Vector | None = None) -> None:
    linear = layer if isinstance(layer, nn.Linear) else next(layer.children())
    assert isinstance(linear, nn.Linear) and linear.weight.shape == (len(weight), len(weight[0]))
    with torch.no_grad():
        linear.weight.copy_(torch.tensor(weight))
        if linear.bias is not None:
            linear.bias.copy_(torch.tensor(bias or [0.0] * len(weight)))


def times(matrix: Rows, vector: Vector, bias: Vector | None = None) -> Vector:
    shift = bias or [0.0] * len(matrix)
    return [
        sum(m * v for m, v in zip(row, vector, strict=True)) + s
        for row, s in zip(matrix, shift, strict=True)
    ]


def plus(*vectors: Vector) -> Vector:
    return [sum(entries) for entries in zip(*vectors, strict=True)]


def relu(vector: Vector) -> Vector:
    return [max(0.0, entry) for entry in vector]


def squash(vector: Vector) -> Vector:
    return [tanh(entry) for entry in vector]


def weigh(query: Vector, keys: Rows, values: Rows) -> Vector:
    """Sum of values weighted by softmax of query . key / sqrt(length of a key)."""
    strengths = [
        exp(sum(q * k for q, k in zip(query, key, strict=True)) / sqrt(len(query))) for key in keys
    ]
    return plus(
        *(
            [strength / sum(strengths) * entry for entry in value]
            for strength, value in zip(strengths, values, strict=True)
        )
    )


def agrees(comm: Comm, expected: Rows, numbers: int) -> None:
    """A scheme gives these features, and each robot pays for this many floats an edge."""
    feature = torch.tensor(FEATURE, dtype=torch.float64)
    talk = comm.double()(feature, LIVE, Senders(RANK))
    require_close(talk.feature, torch.tensor(expected, dtype=torch.float64), "not the equation")
    paid: Tensor = torch.tensor([[2.0], [1.0], [1.0], [0.0]], dtype=torch.float64)
    require_equal(talk.bits, 32 * numbers * paid, "bits")


def plan(combine: str, kind: type[Plan] = Plan) -> None:
    comm = kind(2, message_dim=1, hidden=2, received=2, combine=combine, max_neighbours=2)
    put(comm.message[0], A, SHIFT)
    put(comm.message[2], [[1.0, 0.5]])
    put(comm.received, [[2.0], [-1.0]], SHIFT)
    put(comm.own, B)
    put(comm.join, WIDE if combine == "sum" else WIDER)
    message = [times([[1.0, 0.5]], relu(times(A, h, SHIFT))) for h in FEATURE]
    received = [relu(times([[2.0], [-1.0]], m, SHIFT)) for m in message]
    agrees(comm, [joined(relu(times(B, h)), received, i, combine) for i, h in robots()], numbers=1)


def full_state(combine: str) -> None:
    comm = FullState(
        2, observed=49, hidden=2, received=2, combine=combine, max_neighbours=2, detach=False
    )
    put(comm.received, A, SHIFT)
    put(comm.own, B)
    put(comm.join, WIDE if combine == "sum" else WIDER)
    received = [relu(times(A, h, SHIFT)) for h in FEATURE]
    agrees(comm, [joined(relu(times(B, h)), received, i, combine) for i, h in robots()], numbers=49)


def robots() -> list[tuple[int, Vector]]:
    return list(enumerate(FEATURE))


def joined(own: Vector, received: Rows, robot: int, combine: str) -> Vector:
    """relu(W [own, c]); robot 0 hears 2 first, its nearest."""
    if combine == "sum":
        return relu(times(WIDE, own + plus([0.0, 0.0], *(received[j] for j in HEARS[robot]))))
    nearest = sorted(HEARS[robot], reverse=True)
    places = [entry for j in nearest for entry in received[j]]
    return relu(times(WIDER, own + places + [0.0] * (4 - len(places))))


def commnet(divisor: str, kind: type[CommNet] = CommNet) -> None:
    comm = kind(2, hidden=2, rounds=2, divisor=divisor, detach=False)
    put(comm.skip, A, SHIFT)
    for layer, weight in zip([*comm.own, *comm.heard], [B, C, C, A], strict=True):
        put(layer, weight)
    skip = [times(A, h, SHIFT) for h in FEATURE]
    hidden = [squash(x) for x in skip]
    for own, heard in ((B, C), (C, A)):
        mean = []
        for others in HEARS:
            divided = max(1, len(others)) if divisor == "live" else 3
            mean.append([e / divided for e in plus([0.0, 0.0], *(hidden[j] for j in others))])
        hidden = [
            squash(plus(x, times(own, h), times(heard, m)))
            for x, h, m in zip(skip, hidden, mean, strict=True)
        ]
    agrees(comm, hidden, numbers=4)


def tarmac(self_included: bool = False, rounds: int = 2, kind: type[TarMac] = TarMac) -> None:
    comm = kind(
        2, message_dim=2, key_dim=2, rounds=rounds, self_included=self_included, detach=False
    )
    put(comm.message, A + B, [*SHIFT, 0.5, 0.0])
    put(comm.query, C, SHIFT)
    put(comm.join, WIDE)
    hidden = FEATURE
    for _ in range(rounds):
        keys = [times(A, h, SHIFT) for h in hidden]
        values = [times(B, h, [0.5, 0.0]) for h in hidden]
        after = []
        for i, h in enumerate(hidden):
            heard = HEARS[i] + ([i] if self_included else [])
            query = times(C, h, SHIFT)
            c = weigh(query, [keys[j] for j in heard], [values[j] for j in heard])
            after.append(squash(times(WIDE, h + (c if heard else [0.0, 0.0]))))
        hidden = after
    agrees(comm, hidden, numbers=4 * rounds)


def dgn(heads: int, kind: type[Dgn] = Dgn) -> None:
    """Two rounds; with two heads each has one number."""
    comm = kind(2, hidden=2, heads=heads, head_dim=2 // heads, rounds=2, detach=False, pull=0.0)
    query, key, value, join = (A, B), (B, C), (C, A), (WIDE[0][:2], WIDE[1][:2])
    for i in (0, 1):
        by_head = [
            row
            for head in range(heads)
            for m in (key[i], value[i])
            for row in m[head * 2 // heads : (head + 1) * 2 // heads]
        ]
        put(comm.query[i], query[i], SHIFT)
        put(comm.key_and_value[i], by_head)
        put(comm.join[i], list(join), SHIFT)
    features, hidden = [list(h) for h in FEATURE], FEATURE
    for i in (0, 1):
        after = []
        for robot, h in enumerate(hidden):
            heard, c = [*HEARS[robot], robot], []
            for head in range(heads):
                part = slice(head * 2 // heads, (head + 1) * 2 // heads)
                c += weigh(
                    times(query[i], h, SHIFT)[part],
                    [times(key[i], hidden[j])[part] for j in heard],
                    [times(value[i], hidden[j])[part] for j in heard],
                )
            after.append(relu(times(list(join), c, SHIFT)))
        hidden = after
        features = [before + new for before, new in zip(features, hidden, strict=True)]
    agrees(comm, features, numbers=4)


def ic3net(rounds: int = 1, kind: type[Ic3Net] = Ic3Net) -> None:
    """Robot 1 is silent: what it would say is 0, and what is heard is divided by 3 all the same."""
    comm = kind(2, hidden=2, rounds=rounds, temperature=1.0, detach=False).eval()
    put(comm.skip, A, SHIFT)
    for layer in comm.own:
        put(layer, B)
    for layer in comm.heard:
        put(layer, C)
    put(comm.speaks.logit, [[1.0, -1.0]], [1.0])
    skip = [times(A, h, SHIFT) for h in FEATURE]
    hidden = [squash(x) for x in skip]
    speaks = [times([[1.0, -1.0]], h, [1.0])[0] > 0 for h in hidden]
    for _ in range(rounds):
        total = [plus([0.0, 0.0], *(hidden[j] for j in others if speaks[j])) for others in HEARS]
        hidden = [
            squash(plus(x, times(B, h), times(C, [entry / 3 for entry in m])))
            for x, h, m in zip(skip, hidden, total, strict=True)
        ]
    assert speaks == [True, False, True, True]
    feature = torch.tensor(FEATURE, dtype=torch.float64)
    joined, _, edges, bits, *_ = comm.double()(feature, LIVE, Senders(RANK))
    torch.testing.assert_close(joined, torch.tensor(hidden, dtype=torch.float64))
    sent = [rounds * len(others) * speaks[i] for i, others in enumerate(HEARS)]
    assert edges.sum(-1).tolist() == sent
    assert bits.flatten().tolist() == [64.0 * count for count in sent]


def dial() -> None:
    """In use bits, cut at a > 0, cost a bit each."""
    comm = Dial(
        2, message_dim=2, hidden=2, received=2, combine="sum", max_neighbours=2, noise_std=2.0
    ).eval()
    put(comm.message[0], A, SHIFT)
    put(comm.message[2], C, [-0.25, 0.0])
    put(comm.received, B, SHIFT)
    put(comm.own, B)
    put(comm.join, WIDE)
    logits = [times(C, relu(times(A, h, SHIFT)), [-0.25, 0.0]) for h in FEATURE]
    bits = [[float(entry > 0) for entry in logit] for logit in logits]
    assert any(0 < 1 / (1 + exp(-e)) < 0.5 for logit in logits for e in logit)
    received = [relu(times(B, m, SHIFT)) for m in bits]
    expected = [joined(relu(times(B, h)), received, i, "sum") for i, h in robots()]
    feature = torch.tensor(FEATURE, dtype=torch.float64)
    result, sent, _, cost, *_ = comm.double()(feature, LIVE, Senders(RANK))
    torch.testing.assert_close(result, torch.tensor(expected, dtype=torch.float64))
    assert sent.tolist() == bits
    assert cost.flatten().tolist() == [4.0, 2.0, 2.0, 0.0]
