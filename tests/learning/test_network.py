"""The network from observations to action values."""

import pytest
import torch

from marl_clean.learning.networks import QNetwork
from tests.agent.parts import by_key, frames, make_comm, make_encoder


def network(dueling=True, precision="float32", comm="plan") -> QNetwork:
    encoder = make_encoder()
    return QNetwork(encoder, make_comm(comm, encoder), dueling, precision)


def test_dueling_values_average_to_the_state_value():
    net, batch = network(), frames(3)
    value, _, _ = net(by_key(batch))
    feature = net.comm(net.encoder(batch[0]), *batch[1:])[0]
    torch.testing.assert_close(value.mean(-1), net.head(feature)[..., 0])


@pytest.mark.parametrize("dueling", [True, False])
def test_a_value_for_every_robot_and_action(dueling):
    value, (_, message, edges, bits, _), carried = network(dueling)(by_key(frames(3, n_agents=5)))
    assert value.shape == (3, 5, 4)
    assert message.shape == (3, 5, 32)
    assert edges.shape == bits.shape == (3, 5, 1)
    assert carried == {}


def test_bfloat16_gives_nearly_the_same_values_in_float32():
    batch = by_key(frames(4))
    exact, reduced = network()(batch).out, network(precision="bfloat16")(batch).out
    assert reduced.dtype == torch.float32
    assert not torch.equal(exact, reduced)
    torch.testing.assert_close(exact, reduced, atol=0.02, rtol=0.02)


@pytest.mark.slow
def test_compiles_in_one_graph_with_every_comm(run_script):
    run_script("tests.agent.compiled")
