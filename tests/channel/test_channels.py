"""Every level of conf/channel and some stacks hold the contract; each does what it says, by law."""

import pytest
import torch

from marl_clean.channel.base import Salt, Step
from marl_clean.channel.budget import Budget
from marl_clean.channel.constant import Constant
from marl_clean.channel.delayed import Delayed
from marl_clean.channel.lossy import Lossy
from marl_clean.channel.noisy import Noisy
from marl_clean.channel.quantised import Quantised
from marl_clean.channel.self_send import SelfSend
from marl_clean.testing._broken import Clause
from marl_clean.testing.channel import CLAUSES
from tests.channel.contract import LEVELS, Make, channel, seeds
from tests.comm.contract import draw
from tests.families import family

STACKS: dict[str, list[tuple[str, dict]]] = {
    **{level: [(level, {})] for level in LEVELS},
    "bursts": [("lossy", {"burst_start": 0.3})],
    "old": [("delayed", {"steps": 3})],
    "drawn": [("delayed", {"steps": 2, "random": True})],
    "lossy+delayed+quantised": [
        ("lossy", {"burst_start": 0.2}),
        ("delayed", {}),
        ("quantised", {}),
    ],
    "noisy+budget": [("noisy", {}), ("budget", {"messages": 3})],
}


def made(stack: list[tuple[str, dict]]) -> Make:
    return lambda dims: [channel(level, dims, **changes) for level, changes in stack]


@pytest.mark.parametrize("clause", CLAUSES, ids=lambda clause: clause.__name__)
@family("stack", STACKS.values(), fast=2, ids=STACKS)
def test_the_contract(stack, clause: Clause) -> None:
    clause(made(stack))


def moment(worlds: int, n_agents: int, state=None, seed: int = 0) -> Step:
    return Step(seeds(worlds, n_agents=n_agents, seed=seed), state)


MESSAGE = torch.zeros(4_000, 3, 2)
EVERYBODY = (~torch.eye(3, dtype=torch.bool)).expand(4_000, 3, 3)


def test_controls_transfer_nothing_and_leave_the_contact() -> None:
    features, live, _ = draw(500, n_agents=4)
    own, edges = SelfSend().carry(features, live, 0, moment(500, 4))
    itself = torch.eye(4, dtype=torch.bool)
    assert torch.equal(own, features)
    assert torch.equal(edges, itself & live.any(-1)[..., None])
    assert 0 < edges.sum() < 4 * 500  # some hear themselves, some would hear nobody
    same, edges = Constant(0.5).carry(features, live, 0, moment(500, 4))
    assert (same == 0.5).all() and torch.equal(edges, live)


def test_so_much_is_lost_and_each_direction_for_itself():
    _, edges = Lossy(0.3, 0.0, 0.5, 1.0).carry(MESSAGE, EVERYBODY, 0, moment(4_000, 3))
    arrived = edges[EVERYBODY].float()
    assert abs(arrived.mean() - 0.7) < 4 * (0.3 * 0.7 / 24_000) ** 0.5
    both = edges[:, 0, 1] & edges[:, 1, 0]
    assert abs(both.float().mean() - 0.49) < 4 * (0.49 * 0.51 / 4_000) ** 0.5
    for loss, share in ((0.0, 1.0), (1.0, 0.0)):
        _, edges = Lossy(loss, 0.0, 0.5, 1.0).carry(MESSAGE, EVERYBODY, 0, moment(4_000, 3))
        assert edges[EVERYBODY].float().mean() == share


def test_rounds_of_a_step_share_their_fate():
    lossy, step = Lossy(0.5, 0.0, 0.5, 1.0), moment(4_000, 3)
    assert torch.equal(
        lossy.carry(MESSAGE, EVERYBODY, 0, step)[1], lossy.carry(MESSAGE, EVERYBODY, 1, step)[1]
    )


@pytest.mark.slow
def test_bursts_are_the_chain_that_gilbert_and_elliott_draw():
    lossy = Lossy(0.1, 0.05, 0.25, 0.9)
    state = torch.zeros(400, 2, 2, dtype=torch.bool)
    plain = state.clone()
    bad, lengths, run = 0.0, [], torch.zeros(400, dtype=torch.int64)
    for t in range(400):
        step = moment(400, 2, state, seed=t)
        drawn = step.uniform_of_edges(Salt.BURST)
        for world in range(3):  # by hand, for some
            for i in range(2):
                for j in range(2):
                    u = drawn[world, i, j].item()
                    was = bool(plain[world, i, j])
                    plain[world, i, j] = (u >= 0.25) if was else (u < 0.05)
        _, edges = lossy.carry(MESSAGE[:400, :2], EVERYBODY[:400, :2, :2], 0, step)
        state = lossy.state_after(step, [], [])
        assert torch.equal(state[:3], plain[:3])
        if t >= 50:
            bad += state[:, 0, 1].float().mean().item() / 350
            ended = (run > 0) & ~state[:, 0, 1]
            lengths += run[ended].tolist()
        run = torch.where(state[:, 0, 1], run + 1, 0)
        del edges
    assert bad == pytest.approx(0.05 / 0.30, abs=0.01)  # p / (p + r)
    assert sum(lengths) / len(lengths) == pytest.approx(1 / 0.25, abs=0.15)


def test_noise_is_normal_and_independent():
    noisy = Noisy(0.5)
    message = torch.ones(4_000, 3, 2)
    step = moment(4_000, 3)
    first = noisy.carry(message, EVERYBODY, 0, step)[0] - 1
    second = noisy.carry(message, EVERYBODY, 1, step)[0] - 1
    later = noisy.carry(message, EVERYBODY, 0, moment(4_000, 3, seed=1))[0] - 1
    columns = torch.cat([x.flatten(1) for x in (first, second, later)], dim=1) / 0.5
    assert columns.mean(0).abs().max() < 4 / 4_000**0.5
    assert (columns.std(0) - 1).abs().max() < 0.05
    correlation = torch.corrcoef(columns.T) - torch.eye(columns.shape[1])
    assert correlation.abs().max() < 5 / 4_000**0.5
    assert abs((columns.abs() < 1.96).float().mean() - 0.95) < 0.005


def test_quantised_numbers_are_levels_and_gradients_pass_straight():
    quantised = Quantised(2, 3.0)
    message = torch.tensor([[[-9.0, -3.0, -1.9, -0.1, 0.1, 1.9, 2.1, 9.0]]], requires_grad=True)
    heard, _ = quantised.carry(message, EVERYBODY[:1, :1, :1], 0, moment(1, 1))
    assert heard.flatten().tolist() == [-3, -3, -1, -1, 1, 1, 3, 3]
    heard.sum().backward()
    assert message.grad.flatten().tolist() == [0, 1, 1, 1, 1, 1, 1, 0]
    again, _ = quantised.carry(heard.detach(), EVERYBODY[:1, :1, :1], 0, moment(1, 1))
    assert torch.equal(again, heard.detach())
    fine = torch.linspace(-3, 3, 1_000)
    near, _ = Quantised(8, 3.0).carry(fine.view(1, 1, -1), EVERYBODY[:1, :1, :1], 0, moment(1, 1))
    assert (near.flatten() - fine).abs().max() <= 6 / 255 / 2 + 1e-6


def test_a_budget_writes_to_the_nearest():
    for rounds, messages in ((1, 2), (2, 2), (2, 5), (1, 0), (1, 99)):
        _, live, (rank, _) = draw(30, n_agents=6, share=0.6)
        sent = Budget(messages).address(live, rank, rounds)
        for world in range(30):
            for sender in range(6):
                near = sorted(live[world, :, sender].nonzero()[:, 0].tolist())
                near.sort(key=lambda robot: rank[world, sender, robot])
                expected = set(near[: messages // rounds])
                assert set(sent[world, :, sender].nonzero()[:, 0].tolist()) == expected


def moving(steps: int) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Messages of two rounds and a graph, another each step."""
    generator = torch.Generator().manual_seed(7)
    result = []
    for _ in range(steps):
        live = (torch.rand(5, 4, 4, generator=generator) < 0.5).triu(1)
        result.append((torch.randn(5, 4, 3, generator=generator), live | live.mT))
    return result


DIMS = (2, 1)


@pytest.mark.parametrize("late", [1, 2, 3])
def test_what_is_heard_was_sent_so_many_steps_ago(late):
    delayed = Delayed(late, False, DIMS)
    torch.nn.init.constant_(delayed.age, 0.5)
    state = torch.zeros(5, 4, late, 3 + 2 * 4)
    past = moving(8)
    for t, (message, live) in enumerate(past):
        step = Step(None, state)
        for round_index, part in enumerate(message.split(DIMS, dim=-1)):
            heard, edges = delayed.carry(part, live, round_index, step)
            if t < late:
                assert not edges.any()
                continue
            before, then = past[t - late]
            assert torch.equal(heard, before.split(DIMS, dim=-1)[round_index] + 0.5)
            assert torch.equal(edges, then)
        state = delayed.state_after(step, message.split(DIMS, dim=-1), [live, live])


@pytest.mark.slow
def test_drawn_ages_tell_themselves():
    delayed = Delayed(2, True, DIMS)
    torch.nn.init.constant_(delayed.age, 0.5)
    state, past, ages = torch.zeros(5, 4, 2, 3 + 2 * 4), moving(40), []
    for t, (message, live) in enumerate(past):
        step = Step(seeds(5, n_agents=4, seed=t), state)
        age = delayed.ages(step)
        ages += age.flatten().tolist()
        for round_index, part in enumerate(message.split(DIMS, dim=-1)):
            heard, edges = delayed.carry(part, live, round_index, step)
            for world in range(5):
                for sender in range(4):
                    a = int(age[world, sender])
                    if a > t:
                        assert not edges[world, :, sender].any()
                        continue
                    before, then = past[t - a]
                    sent_values = before.split(DIMS, dim=-1)[round_index][world, sender]
                    torch.testing.assert_close(heard[world, sender], sent_values + 0.5 * a / 2)
                    assert torch.equal(edges[world, :, sender], then[world, :, sender])
        state = delayed.state_after(step, message.split(DIMS, dim=-1), [live, live])
    assert {0, 1, 2} == set(ages)
    assert all(abs(ages.count(a) / len(ages) - 1 / 3) < 0.07 for a in range(3))
