"""Every level of conf/observation holds the contract of observations."""

import pytest

from marl_clean.config.levels import rooms
from marl_clean.testing import check_observation


@pytest.mark.parametrize("level", rooms()["observation"])
def test_the_contract(level: str) -> None:
    check_observation(level)
