"""Every level of conf/observation holds the contract of observations, small and noisy too."""

import pytest

from marl_clean.config.class_source import parameters
from marl_clean.config.levels import read_level, rooms
from marl_clean.testing import check_observation

LEVELS = rooms()["observation"]
SMALL = {"view_size": 5, "scales": 2, "position_noise": 0.3}


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_the_contract(level: str) -> None:
    check_observation(level)


@pytest.mark.long
@pytest.mark.parametrize("level", LEVELS)
def test_the_contract_with_a_small_view_and_noise(level: str) -> None:
    known = parameters(read_level("observation", level)["_target_"])
    check_observation(level, **{key: value for key, value in SMALL.items() if key in known})
