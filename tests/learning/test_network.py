"""The network from observations to action values."""

import pytest
import torch

from marl_clean.channel.delayed import Delayed
from marl_clean.channel.lossy import Lossy
from marl_clean.comm.base import Senders
from marl_clean.errors import BadInput
from marl_clean.learning import arithmetic
from marl_clean.learning.networks import QNetwork
from tests.agent.parts import by_key, frames, make_comm, make_encoder


def network(dueling=True, precision="float32", comm="plan") -> QNetwork:
    encoder = make_encoder()
    return QNetwork(encoder, make_comm(comm, encoder), dueling, precision)


def test_dueling_values_average_to_the_state_value():
    net, batch = network(), frames(3)
    value, _, _ = net(by_key(batch))
    observation, adjacency, rank = batch
    feature = net.comm(net.encoder(observation), adjacency, Senders(rank)).feature
    torch.testing.assert_close(value.mean(-1), net.head(feature)[..., 0])


@pytest.mark.parametrize("dueling", [True, False])
def test_a_value_for_every_robot_and_action(dueling):
    value, talk, carried = network(dueling)(by_key(frames(3, n_agents=5)))
    assert value.shape == (3, 5, 4)
    assert talk.message.shape == (3, 5, 32)
    assert talk.edges.shape == talk.bits.shape == (3, 5, 1)
    assert carried == {}


@pytest.mark.parametrize("has", [True, False])
def test_bfloat16_gives_nearly_the_same_values_in_float32(monkeypatch, has):
    """Exactly the same on a device without it, which computes float32."""
    monkeypatch.setattr(arithmetic, "computes_bfloat16", lambda device: has)
    batch = by_key(frames(4))
    exact, reduced = network()(batch).out, network(precision="bfloat16")(batch).out
    assert reduced.dtype == torch.float32
    assert torch.equal(exact, reduced) != has
    torch.testing.assert_close(exact, reduced, atol=0.02, rtol=0.02)


def test_a_device_says_whether_it_has_bfloat16(monkeypatch):
    found = {"avx2": True, "avx512_bf16": False, "amx_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: found)
    asked = arithmetic._asked.__wrapped__
    assert not asked("cpu")
    found["amx_bf16"] = True
    assert asked("cpu")


def over(*channels: Delayed | Lossy) -> QNetwork:
    encoder = make_encoder()
    stack = {f"level_{number}": channel for number, channel in enumerate(channels)}
    return QNetwork(encoder, make_comm("plan", encoder), True, "float32", channels=stack)


def test_two_channels_do_not_remember_by_one_key():
    first, second = (Delayed(steps, random=False, message_dims=(32,)) for steps in (1, 2))
    refused = r"^channel=level_1: remembers by \('agents', 'inbox'\), as level_0 does, [^\n]*$"
    with pytest.raises(BadInput, match=refused):
        over(first, second)
    bursts = {"loss": 0.1, "burst_start": 0.1, "burst_end": 0.5, "burst_loss": 1.0}
    network = over(first, Lossy(**bursts))
    with pytest.raises(BadInput, match="^channel=Delayed: remembers by"):
        network.put_behind(second)
    assert len(network.carries) == 2
    over(Lossy(**{**bursts, "burst_start": 0.0}), Lossy(**bursts))  # one remembers nothing


@pytest.mark.long
def test_compiles_in_one_graph_with_every_comm(run_script):
    run_script("tests.agent.compiled")
