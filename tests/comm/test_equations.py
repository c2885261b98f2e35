"""Each scheme is its equation: checked on numbers set by hand."""

import pytest
import torch

from marl_clean.comm.dial import Bits
from marl_clean.comm.ic3net import Gate
from tests.comm import equations


@pytest.mark.parametrize("combine", ["ordered", "sum"])
def test_plan(combine: str) -> None:
    equations.plan(combine)


@pytest.mark.parametrize("combine", ["ordered", "sum"])
def test_full_state(combine: str) -> None:
    equations.full_state(combine)


@pytest.mark.parametrize("divisor", ["live", "others"])
def test_commnet(divisor: str) -> None:
    equations.commnet(divisor)


@pytest.mark.parametrize("self_included", [False, True])
@pytest.mark.parametrize("rounds", [1, 2])
def test_tarmac(self_included: bool, rounds: int) -> None:
    equations.tarmac(self_included, rounds)


@pytest.mark.parametrize("heads", [1, 2])
def test_dgn(heads: int) -> None:
    equations.dgn(heads)


@pytest.mark.parametrize("rounds", [1, 2])
def test_ic3net(rounds: int) -> None:
    equations.ic3net(rounds)


def test_dial() -> None:
    equations.dial()


def test_bits_are_noisy_while_learning_and_the_gate_is_a_draw() -> None:
    torch.manual_seed(0)
    logit = torch.full((20_000, 1), 0.5, dtype=torch.float64, requires_grad=True)
    noisy = Bits(noise_std=2.0)(logit.detach())
    expected = (logit.detach() + 2 * torch.randn_like(logit)).sigmoid().mean()
    assert abs(noisy.mean() - expected) < 0.01
    assert torch.equal(Bits(noise_std=0.0)(logit), logit.sigmoid())
    assert Bits(2.0).eval()(torch.tensor([-0.1, 0.0, 0.1])).tolist() == [0, 0, 1]
    gate = Gate(1, temperature=1.0).double()
    equations.put(gate.logit, [[1.0]])
    drawn = gate(logit)
    assert set(drawn.detach().unique().tolist()) <= {0.0, 1.0}
    assert abs(drawn.mean() - torch.tensor(0.5).sigmoid()) < 0.01  # open with its probability
    drawn.sum().backward()
    assert (logit.grad > 0).all()  # also where it is shut
    assert gate.eval()(torch.tensor([[-1.0], [1.0]]).double()).flatten().tolist() == [0, 1]
