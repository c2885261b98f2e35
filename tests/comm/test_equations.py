"""Each scheme is its equation: checked on numbers set by hand."""

import pytest

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
