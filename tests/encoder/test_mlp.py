"""The encoder of vectors: shapes, and robots that do not see each other."""

import pytest
import torch

from marl_clean.encoder.cnn import Cnn
from marl_clean.encoder.mlp import Mlp
from marl_clean.errors import BadInput


def make(entries: int = 8, hidden: tuple[int, ...] = (16, 12), dropout: float = 0.0, **rest) -> Mlp:
    torch.manual_seed(0)
    return Mlp(torch.Size([entries]), list(hidden), dropout, **rest)


@pytest.mark.parametrize("leading", [(), (3,), (2, 3)])
def test_any_leading_dimensions_and_robots_do_not_see_each_other(leading):
    encoder, observation = make(), torch.rand(*leading, 2, 8)
    feature = encoder(observation)
    assert feature.shape == (*leading, 2, encoder.out_features) and encoder.out_features == 12
    changed = observation.clone()
    changed[..., 1, :] = 0.0
    torch.testing.assert_close(encoder(changed)[..., 0, :], feature[..., 0, :])
    assert not torch.equal(encoder(changed)[..., 1, :], feature[..., 1, :])


def test_dropout_acts_only_while_training():
    encoder, observation = make(dropout=0.5), torch.rand(1, 2, 8)
    assert not torch.equal(encoder(observation), encoder(observation))
    encoder.eval()
    assert torch.equal(encoder(observation), encoder(observation))


def test_squares_are_for_the_other():
    with pytest.raises(BadInput, match=r"encoder=mlp: takes a vector, not \[1, 5, 5\]"):
        Mlp(torch.Size([1, 5, 5]), [4], 0.0)
    with pytest.raises(BadInput, match=r"encoder=cnn: takes squares, not \[8\]"):
        Cnn(torch.Size([8]), [4], 3, [1], 1, [4], 0.0, True, True)


def test_layers_are_normalised_before_their_relu():
    encoder, plain, seen = make(norm="layer"), make(), 5 + 3 * torch.rand(4, 2, 8)
    expected = seen
    for layer in [module for module in plain.connected if isinstance(module, torch.nn.Linear)]:
        out = layer(expected)
        centred = out - out.mean(-1, keepdim=True)
        expected = (centred / (centred.square().mean(-1, keepdim=True) + 1e-5).sqrt()).relu()
    torch.testing.assert_close(encoder(seen), expected)
    assert not torch.allclose(plain(seen), expected)
