"""Every level of conf/comm keeps its contract over every level of conf/channel, step after step."""

import pytest
import torch
from torch import Tensor

from marl_clean.channel.base import Channel
from marl_clean.comm.base import Comm
from marl_clean.comm.commnet import CommNet
from marl_clean.config.levels import rooms
from tests.channel.played import (
    LEVELS,
    NEUTRAL,
    Frames,
    Stack,
    features,
    frames,
    network,
    play,
    relabelled,
)
from tests.comm.contract import FEATURES, make, within
from tests.families import family

SCHEMES = [level for level in rooms()["comm"] if level != "autoencoder"]
"""Without the one whose features cross no edge: `tests.comm.test_autoencoder` has its channels."""
STACKS: dict[str, Stack] = {
    **{level: {level: {}} for level in LEVELS if level != "perfect"},  # that is comm's own contract
    "bursts": {"lossy": {"burst_start": 0.3}},
    "drawn ages": {"delayed": {"steps": 2, "random": True}},
    "all": {
        "lossy": {"burst_start": 0.2},
        "delayed": {"steps": 2},
        "noisy": {},
        "quantised": {},
        "budget": {"messages": 2},
    },
}
over_all = pytest.mark.parametrize("stack", STACKS.values(), ids=STACKS)
for_all = family("level", SCHEMES, fast=1, usual=8)


@over_all
@for_all
def test_robots_relabelled_with_their_draws_relabel_the_result(level: str, stack: Stack) -> None:
    net, inputs = network(make(level), stack), frames(3, 6, n_agents=5)
    order = torch.randperm(5, generator=torch.Generator().manual_seed(1))
    there = play(net, relabelled(inputs, order))
    for here, other in zip(play(net, inputs), there, strict=True):
        for one, same in zip(here[:4], other[:4], strict=True):
            torch.testing.assert_close(one[..., order, :], same)


@over_all
def test_a_batch_equals_each_world_alone(stack: Stack) -> None:
    net, inputs = network(make("commnet"), stack), frames(3, 4, n_agents=3)
    together = features(play(net, inputs))
    for world in range(4):
        alone = features(play(net, Frames(*(x[:, world] for x in inputs))))
        torch.testing.assert_close(together[:, world], alone)


@over_all
@for_all
def test_nothing_crosses_where_no_edge_was_ever_live(level: str, stack: Stack) -> None:
    nothing_crosses_where_no_edge_was_ever_live(make(level), stack)


def nothing_crosses_where_no_edge_was_ever_live(comm: Comm, stack: Stack) -> None:
    """Not even NaN, and no gradient; told by the edges of all steps so far."""
    net, inputs = network(comm, stack), frames(3, 6, n_agents=6, share=0.15)
    so_far = inputs.live.cumsum(0) > 0
    before = features(play(net, inputs))
    sender = 0
    hops = comm.rounds * (3 if comm.remembers else 1)  # what is remembered goes on in each step
    deaf = ~within(so_far, hops)[..., sender]
    assert deaf[-1].any()
    feature = inputs.feature.clone().requires_grad_()
    features(play(net, inputs._replace(feature=feature)))[deaf].sum().backward()
    assert not feature.grad[..., sender, :].any()
    poisoned = inputs.feature.clone()
    poisoned[..., sender, :] = torch.nan
    poisoned.requires_grad_()
    after = features(play(net, inputs._replace(feature=poisoned)))
    assert torch.equal(after[deaf], before[deaf])
    after[deaf].sum().backward()
    untouched = ~within(so_far[-1], 2 * hops)[..., sender]
    assert poisoned.grad[:, untouched].isfinite().all()


@over_all
@for_all
def test_nobody_hears_for_free_and_prices_are_those_of_the_channels(
    level: str, stack: Stack
) -> None:
    nobody_hears_for_free(make(level), stack)


def nobody_hears_for_free(comm: Comm, stack: Stack) -> None:
    """Whom a robot's words of one step move, then or later, is at most who was paid for."""
    net, inputs = network(comm, stack), frames(3, 20, n_agents=5, share=0.7)
    talks = play(net, inputs)
    price = min([comm.bits_per_number, *(w.bits_per_number or 32 for w in net.stack)])
    numbers = torch.tensor([comm.numbers(round_index) for round_index in range(comm.rounds)])
    for talk, live in zip(talks, inputs.live, strict=True):
        edges = talk.edges.sum(-1, keepdim=True)
        cost = (price * numbers * talk.edges).sum(-1, keepdim=True)
        torch.testing.assert_close(talk.bits, cost, atol=0, rtol=1e-12)
        assert (edges <= comm.rounds * live.sum(-2).unsqueeze(-1)).all()
        picks = comm.gated or comm.chooses
        if all(type(each).address is Channel.address for each in net.stack) and not picks:
            assert torch.equal(edges, comm.rounds * live.sum(-2).unsqueeze(-1).double())
    if comm.rounds != 1 or comm.remembers:
        return  # others pass on what they heard, and pay for it themselves
    before = features(talks)
    for sender in (1, 2):
        moved = inputs.feature.clone()
        moved[0, :, sender] = -2 * moved[0, :, sender] + 1
        others = play(net, inputs._replace(feature=moved))
        heard = (features(others) != before).any(-1).any(0)
        heard[:, sender] = False
        assert not heard[~inputs.live[0, :, :, sender]].any()
        paid = torch.maximum(talks[0].edges, others[0].edges)  # it may speak in one of both only
        assert (heard.sum(-1) <= paid[:, sender].sum(-1)).all()


@pytest.mark.parametrize("channel", LEVELS)
@for_all
def test_rounds_reach_as_many_hops_and_no_further(level: str, channel: str) -> None:
    """Along a line of robots; seen in some of many worlds, after all delays."""
    comm = make(level)
    net = network(comm, {channel: NEUTRAL.get(channel, {})})
    length, steps = comm.rounds + 3, 1 + comm.rounds * 2
    place = torch.arange(length)
    apart = (place - place[:, None]).abs()
    rank = apart.mul(2).add(place > place[:, None]).argsort(-1).argsort(-1)
    inputs = frames(steps, 16, n_agents=length)
    inputs = inputs._replace(
        live=(apart == 1).expand(inputs.live.shape), rank=rank.expand(inputs.rank.shape)
    )
    before = features(play(net, inputs))[-1]
    for sender in (0, 2):
        moved = inputs.feature.clone()
        moved[:, :, sender] += 1
        after = features(play(net, inputs._replace(feature=moved)))[-1]
        changed = (after != before).any(-1).any(0)
        hops = comm.rounds * (steps if comm.remembers else 1)
        assert not changed[apart[sender] > hops].any()
        if channel in NEUTRAL and not comm.chooses:
            assert changed[apart[sender] <= comm.rounds].all()


@pytest.mark.parametrize("channel", NEUTRAL)
@for_all
def test_at_its_neutral_setting_a_channel_changes_nothing(level: str, channel: str) -> None:
    """In a world that stands still, seen after all delays."""
    comm = make(level)
    if comm.remembers and channel == "delayed":
        pytest.skip("what is remembered changes in a world that stands still, too")
    once = frames(1, 8, n_agents=4, share=0.7)
    inputs = Frames(*(x.expand(1 + comm.rounds * 2, *x.shape[1:]) for x in once))
    plain = features(play(network(comm, {}), inputs))[-1]
    crossed = features(play(network(comm, {channel: NEUTRAL[channel]}), inputs))[-1]
    rough = {"quantised": 2e-3, "noisy": 1e-5}.get(channel, 1e-7)
    torch.testing.assert_close(crossed, plain, atol=rough, rtol=rough)


class Mute(CommNet):
    """Nobody chooses to speak, by a gate that could learn to."""

    def __init__(self) -> None:
        super().__init__(FEATURES, hidden=8, rounds=2, divisor="others", detach=False)
        self.shut = torch.nn.Parameter(torch.zeros(1))

    def gate(self, state: tuple[Tensor, ...], round_index: int) -> Tensor:
        return self.shut.expand(*state[1].shape[:-1], 1)


@over_all
def test_silence_is_heard_as_silence_and_costs_nothing(stack: Stack) -> None:
    silence_is_heard_as_silence(stack)


def silence_is_heard_as_silence(stack: Stack) -> None:
    torch.manual_seed(0)
    comm = Mute()
    net, inputs = network(comm, stack), frames(4, 8, n_agents=4, share=0.9)
    for each in net.stack:
        for weight in each.parameters():
            torch.nn.init.ones_(weight)
    talks = play(net, inputs)
    alone = play(net, inputs._replace(live=torch.zeros_like(inputs.live)))
    assert torch.equal(features(talks), features(alone))
    assert not any(talk.bits.any() or talk.edges.any() for talk in talks)


@pytest.mark.parametrize("channel", NEUTRAL)
def test_a_shut_gate_learns_over_every_channel(channel: str) -> None:
    torch.manual_seed(0)
    comm = Mute()
    net, inputs = network(comm, {channel: NEUTRAL[channel]}), frames(4, 8, n_agents=4, share=0.9)
    features(play(net, inputs)).sum().backward()
    assert comm.shut.grad.isfinite().all() and comm.shut.grad.any()
