"""The encoder's planes, shapes and settings."""

import pytest
import torch
from torch import Tensor

from marl_clean.encoder.cnn import Cnn, spread_codes
from marl_clean.errors import BadInput

CODES = torch.tensor([-1.0, -0.2, 0.0, 0.3, 0.5, 1.0])


def make(shape=(1, 15, 15), **changes) -> Cnn:
    settings = {
        "channels": [4, 6],
        "kernel_size": 3,
        "strides": [1, 2],
        "padding": 1,
        "hidden": [16],
        "dropout": 0.0,
        "planes": True,
        "channels_last": True,
    }
    torch.manual_seed(0)
    return Cnn(torch.Size(shape), **(settings | changes))


def squares(*shape: int) -> Tensor:
    return CODES[torch.randint(len(CODES), shape)]


def test_each_code_lights_its_own_plane():
    blocked, unknown, dirt, robot = spread_codes(CODES.reshape(1, 1, 6)).unbind(0)
    assert blocked[0].tolist() == [1, 0, 0, 0, 0, 0]
    assert unknown[0].tolist() == [0, 1, 0, 0, 0, 0]
    assert dirt[0].tolist() == [0, 0, 1, pytest.approx(0.4), 0, 0]
    assert robot[0].tolist() == [0, 0, 0, 0, 0, 1]


def test_further_channels_follow_the_planes_unchanged():
    observation = squares(2, 3, 2, 5, 5)
    spread = spread_codes(observation)
    assert spread.shape == (2, 3, 5, 5, 5)
    assert torch.equal(spread[..., 4, :, :], observation[..., 1, :, :])


@pytest.mark.parametrize("leading", [(), (3,), (2, 3)])
def test_any_leading_dimensions_and_robots_do_not_see_each_other(leading):
    encoder = make()
    observation = squares(*leading, 2, 1, 15, 15)
    feature = encoder(observation)
    assert feature.shape == (*leading, 2, encoder.out_features)
    changed = observation.clone()
    changed[..., 1, :, :, :] = -1.0
    assert torch.equal(encoder(changed)[..., 0, :], feature[..., 0, :])


@pytest.mark.parametrize("planes", [True, False])
def test_memory_format_does_not_change_the_result(planes):
    observation = squares(4, 2, 1, 15, 15)
    first, second = (
        make(channels_last=True, planes=planes),
        make(channels_last=False, planes=planes),
    )
    torch.testing.assert_close(first(observation), second(observation))


def test_dropout_acts_only_while_training():
    encoder, observation = make(dropout=0.5), squares(1, 2, 1, 15, 15)
    assert not torch.equal(encoder(observation), encoder(observation))
    encoder.eval()
    assert torch.equal(encoder(observation), encoder(observation))


def test_what_does_not_fit_is_bad_input():
    with pytest.raises(BadInput, match=r"encoder\.strides"):
        make(strides=[1])
    with pytest.raises(BadInput, match="too small"):
        make(shape=(1, 3, 3), padding=0)
