"""The encoder's planes, shapes and settings."""

import pytest
import torch
from torch import Tensor

from marl_clean.encoder.cnn import Cnn
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
        "spread": doubled,
    }
    torch.manual_seed(0)
    return Cnn(torch.Size(shape), **(settings | changes))


def squares(*shape: int) -> Tensor:
    return CODES[torch.randint(len(CODES), shape)]


def doubled(observation: Tensor) -> Tensor:
    """Planes of somebody else's: what is positive, what is not, and further channels."""
    code = observation[..., :1, :, :]
    return torch.cat([code > 0, code <= 0, observation[..., 1:, :, :]], -3)


def test_planes_are_those_of_the_observation():
    observation = squares(4, 2, 2, 15, 15)
    encoder = make(shape=(2, 15, 15))
    assert encoder.convolutions[0].in_channels == 3
    spread_before = make(shape=(3, 15, 15), planes=False)
    spread_before.load_state_dict(encoder.state_dict())
    assert torch.equal(spread_before(doubled(observation)), encoder(observation))
    assert make(shape=(2, 15, 15), spread=None).convolutions[0].in_channels == 2


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


@pytest.mark.parametrize(
    ("side", "strides", "exact"), [(1, [1, 2], [True, True]), (7, [2, 4, 2], [False, False, True])]
)
def test_convolutions_of_one_cell_are_in_float32(side, strides, exact):
    """In bfloat16 torch returns gradients of them, on a CPU, that are memory never written to."""
    observation = squares(8, 2, 1, side, side)

    def learnt(precision: torch.dtype) -> tuple[Tensor, list[torch.dtype]]:
        encoder = make(shape=(1, side, side), channels=[4] * len(strides), strides=strides)
        seen: list[torch.dtype] = []
        for layer in encoder.convolutions[::2]:
            layer.register_forward_hook(lambda layer, given, made: seen.append(made.dtype))
        with torch.autocast("cpu", precision, enabled=precision is not torch.float32):
            feature = encoder(observation)
        feature.float().square().sum().backward()
        return torch.cat([weight.grad.flatten() for weight in encoder.parameters()]), seen

    first, seen = learnt(torch.bfloat16)
    assert seen == [torch.float32 if each else torch.bfloat16 for each in exact]
    junk = [torch.full((size,), 3e38) for size in range(1, 4096, 64)]
    del junk  # what is returned unwritten is now this
    assert torch.equal(first, learnt(torch.bfloat16)[0])
    torch.testing.assert_close(first, learnt(torch.float32)[0], atol=0.2, rtol=0.1)
