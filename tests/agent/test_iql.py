"""Independent Q-learning against plain PyTorch, line for line."""

import copy

import pytest
import torch
from torch import nn
from torchrl.data import Categorical, Composite
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import keys
from marl_clean.learning.acting import entries
from tests.agent.parts import make_agent, make_encoder, transitions

LOSSES = {
    "smooth_l1": nn.functional.smooth_l1_loss,
    "l2": nn.functional.mse_loss,
    "l1": nn.functional.l1_loss,
}


class Plain:
    """Double deep Q-learning as one would write it by hand."""

    def __init__(self, agent, *, double, loss, tau=None, period=None, gamma=0.9, lr=1e-3):
        self.network, self.target = copy.deepcopy(agent.network), copy.deepcopy(agent.network)
        self.double, self.loss, self.gamma = double, LOSSES[loss], gamma
        self.tau, self.period, self.updates = tau, period, 0
        self.adam = torch.optim.Adam(self.network.parameters(), lr=lr, fused=True)

    def update(self, batch):
        agents, later = batch[keys.AGENTS], batch["next", keys.AGENTS]
        now, then = (entries(self.network, frames) for frames in (batch, batch["next"]))
        with torch.no_grad():
            chooser = self.network if self.double else self.target
            best = chooser(then).out.argmax(-1, keepdim=True)
            value = self.target(then).out.gather(-1, best)[..., 0]
            discount = self.gamma ** batch[keys.STEPS_TO_NEXT_OBS][:, None]
            goal = later["reward"][..., 0] + discount * ~batch["next", "terminated"] * value
        chosen = self.network(now).out.gather(-1, agents["action"][..., None])[..., 0]
        loss = self.loss(chosen, goal)
        self.adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.adam.step()
        self.updates += 1
        with torch.no_grad():
            for slow, fast in zip(self.target.parameters(), self.network.parameters(), strict=True):
                if self.tau is not None:
                    slow.lerp_(fast, self.tau)
                elif self.updates % self.period == 0:
                    slow.copy_(fast)
        return loss.detach()


@pytest.mark.parametrize("comm", ["none", "plan"])
@pytest.mark.parametrize(
    ("double", "loss", "target"),
    [(True, "smooth_l1", "soft"), (False, "l2", "hard"), (True, "l1", "hard")],
)
def test_updates_equal_plain_pytorch(comm, double, loss, target):
    agent = make_agent(comm, double=double, loss=loss, target_update=target)
    rule = {"tau": 0.1} if target == "soft" else {"period": 3}
    plain = Plain(agent, double=double, loss=loss, **rule)
    for step in range(7):
        batch = transitions(8, seed=10 * step)
        torch.testing.assert_close(agent.update(batch)["loss"], plain.update(batch))
    for learned, expected in zip(
        agent.network.parameters(), plain.network.parameters(), strict=True
    ):
        torch.testing.assert_close(learned, expected)
    for learned, expected in zip(
        agent.state_dict()["target"].values(), plain.target.parameters(), strict=True
    ):
        torch.testing.assert_close(learned, expected.data)


def test_an_update_leaves_the_batch_as_it_was():
    batch = transitions(8)
    before = batch.clone()
    make_agent(augment=True).update(batch)
    assert set(batch.keys(True, True)) == set(before.keys(True, True))
    assert (batch == before).all()


def test_the_loss_of_one_robot_moves_what_its_neighbour_sends():
    agent = make_agent("plan")
    batch = transitions(1)
    batch[keys.ADJACENCY] = ~torch.eye(2, dtype=torch.bool)[None]
    agent.update(batch)
    message = [p for name, p in agent.network.named_parameters() if "comm.message" in name]
    assert all(p.grad.abs().sum() > 0 for p in message)
    batch[keys.ADJACENCY] = torch.zeros(1, 2, 2, dtype=torch.bool)
    agent.update(batch)
    assert all(p.grad.abs().sum() == 0 for p in message)


def test_greedy_actions_have_the_highest_value_and_messages_are_reported():
    policy = make_agent().policy()
    seen = policy(transitions(5).exclude("next"))
    assert torch.equal(seen[keys.ACTION], seen[keys.ACTION_VALUE].argmax(-1))
    assert seen[keys.MESSAGE].shape == (5, 2, 32)
    expected = 32 * 32 * seen[keys.ADJACENCY].sum(-1, keepdim=True)
    assert torch.equal(seen[keys.MESSAGE_BITS], expected.float())


ACTIONS = Composite(
    agents=Composite(action=Categorical(4, shape=(500, 2)), shape=(500, 2)), shape=(500,)
)


def test_exploration_draws_a_coin_for_each_robot_and_falls_linearly():
    agent = make_agent("none", eps_init=1.0, eps_end=0.1, annealing_fraction=0.5)
    explore = agent.exploration(ACTIONS)
    batch = transitions(1).exclude("next").expand(500).clone()
    greedy = agent.policy()(batch.clone())[keys.ACTION]

    def share_random(progress: float) -> float:
        agent.anneal(progress)
        with set_exploration_type(ExplorationType.RANDOM):
            changed = explore(batch.clone())[keys.ACTION] != greedy
        both = changed[:, 0] & changed[:, 1]
        share = changed.float().mean().item()
        assert both.float().mean().item() == pytest.approx(share**2, abs=0.08)
        return share / 0.75

    torch.manual_seed(0)
    assert share_random(0.0) == pytest.approx(1.0, abs=0.08)
    assert share_random(0.25) == pytest.approx(0.55, abs=0.08)
    assert share_random(0.5) == pytest.approx(0.1, abs=0.05)
    assert share_random(1.0) == pytest.approx(0.1, abs=0.05)
    assert agent.exploring.now == pytest.approx(0.1)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(explore(batch.clone())[keys.ACTION], greedy)


def test_augmented_batches_teach_the_rotated_house():
    agent = make_agent("plan", augment=True)
    batch = transitions(16)
    learnt = agent._frames_to_learn(batch)
    assert not torch.equal(learnt[keys.OBSERVATION], batch[keys.OBSERVATION])
    assert torch.equal(learnt[keys.OBSERVATION][:2], batch[keys.OBSERVATION][:2])
    agent.update(batch)


def test_dropout_acts_in_learning_only():
    agent = make_agent(encoder=make_encoder(dropout=0.5))
    batch = transitions(4)
    act = agent.policy()
    first = act(batch.exclude("next"))[keys.ACTION_VALUE].clone()
    agent.update(batch)
    seen = batch.exclude("next")
    assert not torch.equal(first, act(seen.clone())[keys.ACTION_VALUE])
    assert torch.equal(act(seen.clone())[keys.ACTION_VALUE], act(seen.clone())[keys.ACTION_VALUE])


@pytest.mark.slow
@pytest.mark.parametrize("target", ["soft", "hard"])
def test_learning_goes_on_exactly_from_a_state(target):
    first, second = make_agent(target_update=target), make_agent(target_update=target)
    for step in range(4):
        first.update(transitions(8, seed=step))
    state = copy.deepcopy(first.state_dict())
    second.load_state_dict(state)
    for step in range(4, 8):
        one = first.update(transitions(8, seed=step))
        other = second.update(transitions(8, seed=step))
        assert all(torch.equal(one[name], other[name]) for name in one)
    ours, others = first.state_dict(), second.state_dict()
    for part in ("network", "target"):
        assert all(torch.equal(ours[part][name], others[part][name]) for name in ours[part])


def test_a_state_is_tensors_and_plain_numbers():
    def check(tree):
        if isinstance(tree, dict):
            return all(check(value) for value in tree.values())
        if isinstance(tree, list | tuple):
            return all(check(value) for value in tree)
        return tree is None or isinstance(tree, torch.Tensor | int | float | bool | str)

    agent = make_agent()
    agent.update(transitions(4))
    assert check(dict(agent.state_dict()))


def test_greedy_policy_takes_any_number_of_robots():
    policy = make_agent().policy()
    assert policy(transitions(3, n_agents=8).exclude("next"))[keys.ACTION].shape == (3, 8)


def all_in_contact(count: int):
    batch = transitions(count)
    both = (~torch.eye(2, dtype=torch.bool)).expand(count, 2, 2).clone()
    batch[keys.ADJACENCY], batch["next", keys.ADJACENCY] = both, both.clone()
    return batch


def test_replayed_messages_are_heard_as_sent_and_teach_the_sender_nothing():
    agent, batch = make_agent("plan", messages="replayed"), all_in_contact(4)
    assert keys.MESSAGE in agent.learns_from
    batch[keys.MESSAGE] = torch.randn(4, 2, 32)
    expected = agent.network(entries(agent.network, batch), batch[keys.MESSAGE]).out
    torch.testing.assert_close(agent.values(agent.network, batch), expected)
    assert not torch.equal(expected, agent.network(entries(agent.network, batch)).out)
    agent.update(batch)
    weights = dict(agent.network.named_parameters())
    message = [weight for name, weight in weights.items() if "comm.message" in name]
    assert all(weight.grad is None or not weight.grad.any() for weight in message)
    assert weights["comm.received.0.weight"].grad.any()


def test_replayed_messages_as_they_were_sent_now_give_the_same_values():
    agent, batch = make_agent("commnet", messages="replayed"), all_in_contact(4)
    seen = entries(agent.network, batch)
    value, talk, _ = agent.network(seen)
    torch.testing.assert_close(agent.network(seen, talk.message).out, value)


@pytest.mark.parametrize("comm", ["none", "zeroed"])
def test_where_nothing_is_said_nothing_is_replayed(comm):
    mute, replaying = make_agent(comm), make_agent(comm, messages="replayed")
    batch = all_in_contact(4)
    expected = mute.update(batch.clone())["loss"]
    batch[keys.MESSAGE] = torch.zeros(4, 2, 0)
    assert torch.equal(replaying.update(batch)["loss"], expected)


def test_the_next_graph_may_be_reused():
    batch = all_in_contact(6)
    batch["next", keys.ADJACENCY] = torch.zeros(6, 2, 2, dtype=torch.bool)
    own, reused = make_agent("plan"), make_agent("plan", next_graph="reused")
    other = batch.clone()
    other["next", keys.ADJACENCY] = batch[keys.ADJACENCY].clone()
    expected = make_agent("plan").update(other)["loss"]
    assert torch.equal(reused.update(batch)["loss"], expected)
    assert not torch.equal(own.update(batch)["loss"], expected)


def test_attention_is_pulled_towards_that_of_the_next_frame():
    batch = all_in_contact(6)
    plain, pulled = make_agent("dgn"), make_agent("dgn")
    pulled.network.comm.pull = 0.5
    extra = pulled.pull_loss(batch)
    now, later = (
        pulled.network(entries(pulled.network, frames)).talk.attention
        for frames in (batch, batch["next"])
    )
    assert now.shape == (6, 2, 2, 2)  # frames, heads, robots, robots
    divergence = (now * (now / later).log()).sum(-1).mean()
    torch.testing.assert_close(extra, 0.5 * divergence)
    same = batch.clone()
    same["next", keys.OBSERVATION] = batch[keys.OBSERVATION].clone()
    assert pulled.pull_loss(same).item() == pytest.approx(0.0, abs=1e-6)
    (grad,) = torch.autograd.grad(extra, pulled.network.comm.query[1].weight)
    assert grad.any()
    loss = plain.update(batch.clone())["loss"]
    torch.testing.assert_close(pulled.update(batch)["loss"], loss + extra)
