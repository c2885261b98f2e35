"""How the codes of observations spread over planes for an encoder."""

import pytest
import torch

from marl_clean.observation.crop import Crop
from marl_clean.observation.distances import Distances
from marl_clean.observation.frontier import Frontier
from marl_clean.observation.global_map import GlobalMap
from marl_clean.observation.pyramid import Pyramid

CODES = torch.tensor([-1.0, -0.2, 0.0, 0.3, 0.5, 1.0])


def test_each_code_lights_its_own_plane():
    blocked, unknown, dirt, robot = Crop.spread(CODES.reshape(1, 1, 6)).unbind(0)
    assert blocked[0].tolist() == [1, 0, 0, 0, 0, 0]
    assert unknown[0].tolist() == [0, 1, 0, 0, 0, 0]
    assert dirt[0].tolist() == [0, 0, 1, pytest.approx(0.4), 0, 0]
    assert robot[0].tolist() == [0, 0, 0, 0, 0, 1]


def test_further_channels_follow_the_planes_unchanged():
    observation = CODES[torch.randint(len(CODES), (2, 3, 2, 5, 5))]
    spread = Crop.spread(observation)
    assert spread.shape == (2, 3, 5, 5, 5)
    assert torch.equal(spread[..., 4, :, :], observation[..., 1, :, :])


@pytest.mark.parametrize("level", [Frontier, GlobalMap, Pyramid])
def test_maps_spread_alike(level):
    observation = CODES[torch.randint(len(CODES), (3, 2, 7, 7))]
    assert torch.equal(level.spread(observation), Crop.spread(observation))


def test_what_holds_no_codes_is_as_it_is():
    observation = torch.rand(3, 8)
    assert Distances.spread(observation) is observation
