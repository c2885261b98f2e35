"""Small faults of the tensor world are seen by the comparison with the plain one."""

import pytest

from tests.reliability.simulator import MUTANTS, is_caught

pytestmark = [pytest.mark.long, pytest.mark.usefixtures("unchecked", "one_thread")]


@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_seen(name: str) -> None:
    assert is_caught(MUTANTS[name], 18_000)
