"""Channels of a stack are crossed in their order, the first nearest to the sender."""

from itertools import permutations

import pytest
import torch
from torch import Tensor

from marl_clean.channel.base import Channel, Step
from marl_clean.channel.quantised import Quantised
from marl_clean.config.compose import compose_config
from marl_clean.learning.delivery import Stacked
from tests.channel.played import LEVELS, Frames, frames, make_channel

DIMS = (3, 2)
CHANGES = {"lossy": {"burst_start": 0.3}, "delayed": {"steps": 2}, "budget": {"messages": 3}}


def cross(channels: list[Channel], inputs: Frames) -> list[tuple[Tensor, Tensor]]:
    """What is heard of each round of each step, and over which edges; nothing is carried in."""
    batch, n_agents = inputs.seed.shape[1:-1], inputs.seed.shape[-1]
    heard = []
    carrying = [channel.remembers is not None for channel in channels]
    kept = [w.state_spec(n_agents, DIMS).zero(batch) for w in channels if w.remembers is not None]
    for message, live, rank, seed, _ in zip(*inputs, strict=True):
        left = iter(kept)
        states = [next(left) if carries else None for carries in carrying]
        delivery = Stacked(channels, live, rank, len(DIMS), seed, states)
        parts = message[..., : sum(DIMS)].float().split(DIMS, dim=-1)
        heard += [delivery(part, round_index) for round_index, part in enumerate(parts)]
        kept = list(delivery.states_after().values())
    return heard


@pytest.mark.parametrize("names", [*permutations(LEVELS, 2), ("lossy", "delayed", "quantised")])
def test_what_one_lets_through_comes_to_the_next(names: tuple[str, ...]) -> None:
    """By hand, one channel after the other, over the edges that all of them let be written to."""
    channels = [make_channel(name, DIMS, **CHANGES.get(name, {})) for name in names]
    inputs = frames(5, 4, n_agents=4, share=0.8)
    results = iter(cross(channels, inputs))
    states = [
        channel.state_spec(4, DIMS).zero((4,)) if channel.remembers is not None else None
        for channel in channels
    ]
    for message, live, rank, seed, _ in zip(*inputs, strict=True):
        sent = live
        for channel in channels:
            sent = channel.address(sent, rank, len(DIMS))
        steps = [Step(seed, state) for state in states]
        messages, over_edges = [[] for _ in channels], [[] for _ in channels]
        for round_index, part in enumerate(message[..., : sum(DIMS)].float().split(DIMS, dim=-1)):
            edges = sent
            for index, channel in enumerate(channels):
                messages[index].append(part)
                over_edges[index].append(edges)
                part, edges = channel.carry(part, edges, round_index, steps[index])
            heard, over = next(results)
            assert torch.equal(heard, part) and torch.equal(over, edges)
        states = [
            channel.state_after(*came) if channel.remembers is not None else None
            for channel, *came in zip(channels, steps, messages, over_edges, strict=True)
        ]


def test_what_is_rounded_last_is_a_level_and_what_is_noisy_last_is_none() -> None:
    inputs, few = frames(1, 6, n_agents=4), {"bits": 2, "limit": 3.7}
    noisy, quantised = make_channel("noisy", DIMS), make_channel("quantised", DIMS, **few)
    last = torch.cat([heard.flatten() for heard, _ in cross([noisy, quantised], inputs)])
    assert len(last.unique()) == 4
    first = torch.cat([heard.flatten() for heard, _ in cross([quantised, noisy], inputs)])
    assert len(first.unique()) == first.numel()


def test_what_is_lost_before_a_delay_was_lost_when_it_was_sent() -> None:
    inputs = frames(6, 20, n_agents=4, share=0.9)
    lossy, delayed = make_channel("lossy", DIMS, loss=0.5), make_channel("delayed", DIMS)
    arrives = [edges for _, edges in cross([lossy], inputs)[::2]]
    sent_first = [edges for _, edges in cross([lossy, delayed], inputs)[::2]]
    heard_first = [edges for _, edges in cross([delayed, lossy], inputs)[::2]]
    survives = [
        edges
        for _, edges in cross([lossy], inputs._replace(live=torch.ones_like(inputs.live)))[::2]
    ]
    for t in range(1, 6):
        assert torch.equal(sent_first[t], arrives[t - 1])
        assert torch.equal(heard_first[t], inputs.live[t - 1] & survives[t])


@pytest.mark.parametrize("bits", [1, 2, 3, 8, 16])
@pytest.mark.parametrize("limit", [0.3, 1.0, 3.7])
def test_a_quantised_number_says_its_level_and_nothing_else(bits: int, limit: float) -> None:
    """To the last digit, and again the same if it is quantised again."""
    quantised, alive = Quantised(bits, limit), torch.ones(1, 1, 1, dtype=torch.bool)
    message = 2 * limit * torch.linspace(-1, 1, 30_001).view(1, 1, -1)
    heard, _ = quantised.carry(message, alive, 0, Step(None, None))
    assert len(heard.unique()) <= 2**bits
    again, _ = quantised.carry(heard, alive, 0, Step(None, None))
    assert torch.equal(again, heard)


@pytest.mark.long
def test_runs_of_another_order_have_another_name() -> None:
    stacks = ["lossy,delayed", "delayed,lossy", "delayed,lossy,noisy", "delayed,noisy,lossy"]
    assert len({compose_config([f"channel=[{stack}]"]).name for stack in stacks}) == 4
    assert compose_config(["channel=[lossy]"]).name == compose_config(["channel=lossy"]).name
