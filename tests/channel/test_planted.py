"""Planted defects: channels that are nearly right break the contract, or the law of their level."""

from dataclasses import replace

import pytest
import torch

from marl_clean.channel.base import Channel, Salt, Step
from marl_clean.channel.budget import Budget
from marl_clean.channel.delayed import Delayed, Later
from marl_clean.channel.lossy import Lossy
from marl_clean.channel.noisy import Noisy
from marl_clean.channel.quantised import Quantised
from marl_clean.testing import ContractBroken, check_channel
from marl_clean.testing._broken import require, require_equal
from tests.channel.contract import Make
from tests.channel.test_channels import DIMS, EVERYBODY, moment, moving
from tests.comm.contract import draw
from tests.families import family


class Free(Lossy):
    """Lost messages are not paid for."""

    def address(self, edges, distance_rank, rounds):
        return torch.zeros_like(edges)

    def carry(self, message, edges, round_index, step):
        return message, edges


class OffByOne(Later):
    """Heard a step earlier than it says."""

    def carry(self, message, edges, round_index, step):
        newest = step.state[..., 0, :]
        return newest[..., self.parts[round_index]], self.reaches(newest, round_index).mT > 0


class Endless(Lossy):
    """A burst never ends."""

    def state_after(self, step, messages, edges):
        return step.state | super().state_after(step, messages, edges)


class Leaking(Quantised):
    """Rounds, and says the rest too."""

    def carry(self, message, edges, round_index, step):
        heard, edges = super().carry(message, edges, round_index, step)
        return heard + 1e-3 * message, edges


class ByReceiver(Budget):
    """Each robot hears its nearest, however much those send."""

    def address(self, edges, distance_rank, rounds):
        return super().address(edges.mT, distance_rank.mT, rounds).mT


class OneForAll(Noisy):
    """All robots' numbers get the same noise."""

    def carry(self, message, edges, round_index, step):
        noise = step.normal(Salt.NOISE, message.shape[-1], round_index)[..., :1, :]
        return message + self.std * noise.to(message.dtype), edges


class Multiplying(Channel):
    """Silences edges by a product with 0 in the mail of all."""

    def carry(self, message, edges, round_index, step):
        return message + 0 * message.sum(-2, keepdim=True), edges


class Spilling(Delayed):
    """What is under way of each robot is touched by everybody's."""

    def state_after(self, step, messages, edges):
        state = super().state_after(step, messages, edges)
        return state + 0 * state[..., : self.width].sum((-1, -2, -3), keepdim=True)


class Unpaid(Budget):
    """Pays for the nearest and writes to all."""

    def address(self, edges, distance_rank, rounds):
        self.all = edges
        return super().address(edges, distance_rank, rounds)

    def carry(self, message, edges, round_index, step):
        return message, self.all


class HissingNoise(Noisy):
    """Is heard where nobody speaks."""

    def carry(self, message, edges, round_index, step):
        return super().carry(message, edges, round_index, replace(step, gated=False))


class InOrder(Noisy):
    """Each robot gets its neighbour's noise."""

    def carry(self, message, edges, round_index, step):
        noise = step.normal(Salt.NOISE, message.shape[-1], round_index).roll(1, -2)
        return step.unless_silent(message, message + noise.to(message.dtype)), edges


class NoDraws(Lossy):
    """Draws and does not say so."""

    draws = False


class OfItsOwn(Noisy):
    """Draws from torch's generator."""

    def carry(self, message, edges, round_index, step):
        return step.unless_silent(message, message + torch.randn_like(message)), edges


class InVain(Channel):
    """Asks for draws that it does not use."""

    draws = True


class AtOnce(Later):
    """Does not say that it is late."""

    def __init__(self, steps, message_dims):
        super().__init__(steps, message_dims)
        self.steps_late = 0


class OverWorlds(Channel):
    """Takes all worlds together."""

    def carry(self, message, edges, round_index, step):
        if message.ndim < 3:
            return message, edges
        return step.unless_silent(message, message - message.detach().nan_to_num().mean()), edges


class Everywhere(Channel):
    """Sends to everybody."""

    def address(self, edges, distance_rank, rounds):
        return torch.ones_like(edges)


class Growing(Later):
    """Carries one step more after each."""

    def state_after(self, step, messages, edges):
        return torch.cat([step.state, super().state_after(step, messages, edges)], dim=-2)


@pytest.mark.parametrize(
    ("planted", "check"),
    [
        (lambda dims: [Free(0.5, 0.0, 0.5, 1.0)], lambda m: lost_is_paid(m)),
        (lambda dims: [OffByOne(2, dims)], lambda m: late_by_two(m)),
        (lambda dims: [Endless(0.0, 0.2, 0.5, 1.0)], lambda m: bursts_end(m)),
        (lambda dims: [Leaking(2, 3.0)], lambda m: few_levels(m)),
        (lambda dims: [ByReceiver(1)], lambda m: one_each(m)),
        (lambda dims: [OneForAll(1.0)], lambda m: noise_differs(m)),
    ],
)
def test_planted_defects_are_caught(planted, check):
    with pytest.raises(ContractBroken):
        check(planted)


LOSSY = {"loss": 0.5, "burst_start": 0.0, "burst_end": 0.5, "burst_loss": 1.0}


@family(
    ("wrong", "settings", "broken"),
    [
        (Multiplying, {}, "NaN of robot 0 crosses a dead edge to"),
        (Spilling, {"steps": 1, "random": False}, "NaN of robot 0 crosses a dead edge"),
        (Unpaid, {"messages": 1}, "is heard by more robots than it pays for"),
        (HissingNoise, {"std": 0.5}, "silent robots are heard: at"),
        (InOrder, {"std": 0.5}, r"renumbered as \[2, 0, 4, 1, 3\] get other results: at"),
        (NoDraws, LOSSY, "AssertionError"),
        (OfItsOwn, {"std": 0.5}, "the same draws give another result: at"),
        (InVain, {}, "draws is True, but other draws give the same result"),
        (AtOnce, {"steps": 2, "message_dims": None}, "steps_late is 0 in all"),
        (OverWorlds, {}, "gives another result alone: at"),
        (Everywhere, {}, "address sends over an edge that is not live"),
        (Growing, {"steps": 1, "message_dims": None}, "as state_spec says"),
    ],
    fast=4,
)
def test_the_contract_refuses(wrong: type[Channel], settings: dict, broken: str) -> None:
    given = {key: value for key, value in settings.items() if value is not None}
    with pytest.raises(ContractBroken, match=f"^channel={wrong.__name__}.*: .*{broken}"):
        check_channel(wrong, **given)


@pytest.mark.parametrize(
    ("right", "check"),
    [
        (lambda dims: [Lossy(0.5, 0.0, 0.5, 1.0)], lambda m: lost_is_paid(m)),
        (lambda dims: [Later(2, dims)], lambda m: late_by_two(m)),
        (lambda dims: [Lossy(0.0, 0.2, 0.5, 1.0)], lambda m: bursts_end(m)),
        (lambda dims: [Quantised(2, 3.0)], lambda m: few_levels(m)),
        (lambda dims: [Budget(1)], lambda m: one_each(m)),
        (lambda dims: [Noisy(1.0)], lambda m: noise_differs(m)),
    ],
)
def test_the_same_checks_pass_without_the_defect(right, check):
    check(right)


def lost_is_paid(make: Make) -> None:
    [lossy] = make(DIMS)
    _, live, (rank, _) = draw(50, n_agents=4)
    require_equal(lossy.address(live, rank, 1), live, "lost messages are not paid for")
    _, edges = lossy.carry(torch.zeros(50, 4, 2), live, 0, moment(50, 4))
    require(edges.sum() < live.sum(), "nothing is lost")


def late_by_two(make: Make) -> None:
    [later] = make(DIMS)
    state, past = torch.zeros(5, 4, 2, 3 + 2 * 4), moving(4)
    for t, (message, live) in enumerate(past):
        step = Step(None, state)
        heard, _ = later.carry(message[..., :2], live, 0, step)
        if t >= 2:
            require_equal(heard, past[t - 2][0][..., :2], "not what was sent two steps ago")
        state = later.state_after(step, message.split(DIMS, dim=-1), [live, live])


def bursts_end(make: Make) -> None:
    [lossy] = make(DIMS)
    state = torch.zeros(200, 2, 2, dtype=torch.bool)
    for t in range(60):
        state = lossy.state_after(moment(200, 2, state, seed=t), [], [])
    require(state.float().mean() < 0.5, "bursts do not end")


def few_levels(make: Make) -> None:
    [quantised] = make(DIMS)
    message = torch.linspace(-2.9, 2.9, 500).view(1, 1, -1)
    heard, _ = quantised.carry(message, EVERYBODY[:1, :1, :1], 0, moment(1, 1))
    require(len(heard.unique()) <= 2**quantised.bits_per_number, "more than its levels")


def one_each(make: Make) -> None:
    [budget] = make(DIMS)
    _, live, (rank, _) = draw(50, n_agents=5, share=0.8)
    require(budget.address(live, rank, 1).sum(-2) <= 1, "a robot sends more than its budget")


def noise_differs(make: Make) -> None:
    [noisy] = make(DIMS)
    heard, _ = noisy.carry(torch.zeros(50, 3, 2), EVERYBODY[:50], 0, moment(50, 3))
    require(not torch.equal(heard[:, 0], heard[:, 1]), "the same noise for all")
