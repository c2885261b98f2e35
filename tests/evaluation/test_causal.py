"""Changed messages and what they do, by hand on numbers and in play."""

import math
from dataclasses import replace

import pytest
import torch
from torch import nn

from marl_clean import build, cli, keys
from marl_clean.channel.base import Step
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.causal import change
from marl_clean.evaluation.evaluator import evaluate, in_any_env
from marl_clean.evaluation.interventions import (
    INTERVENTIONS,
    Freeze,
    Mean,
    Noise,
    Open,
    Shuffle,
    Shut,
    Zero,
    communicating,
    intervened,
    named,
)
from marl_clean.evaluation.listening import differences_of, listening
from marl_clean.evaluation.records import make_entry
from tests.families import family

pytestmark = pytest.mark.usefixtures("unchecked")

BASE = [
    "house.rows=[6,6]",
    "house.cols=[6,6]",
    "observation.view_size=5",
    "env.n_agents=3",
    "env.num_envs=2",
    "env.max_steps=25",
    "train_houses=4",
    "agent.precision=float32",
]


def step(seed: int = 0, worlds: int = 4, n_agents: int = 3, state=None) -> Step:
    drawn = torch.randint(2**32, (worlds, n_agents), generator=torch.Generator().manual_seed(seed))
    return Step(drawn, state)


MESSAGE = torch.arange(24.0).view(4, 3, 2)
EDGES = torch.zeros(4, 3, 3, dtype=torch.bool)
EDGES[:, 0, 1] = True


def test_zero_open_and_shut_by_hand():
    heard, edges = Zero().carry(MESSAGE, EDGES, 0, step())
    assert not heard.any() and torch.equal(edges, EDGES)
    heard, edges = Open().carry(MESSAGE, EDGES, 0, step())
    assert torch.equal(heard, MESSAGE) and torch.equal(edges[2], ~torch.eye(3, dtype=torch.bool))
    heard, edges = Shut().carry(MESSAGE, EDGES, 0, step())
    assert torch.equal(heard, MESSAGE) and not edges.any()


@pytest.mark.parametrize("shift", [1, 5, 11, 12])
def test_shuffled_messages_are_all_there_and_none_is_its_own(shift):
    for seed in range(20):
        heard, edges = Shuffle(shift).carry(MESSAGE, EDGES, 0, step(seed))
        assert sorted(heard[..., 0].flatten().tolist()) == MESSAGE[..., 0].flatten().tolist()
        assert not (heard == MESSAGE).any() and torch.equal(edges, EDGES)
    again = Shuffle(shift).carry(MESSAGE, EDGES, 0, step(19))[0]
    assert torch.equal(again, heard)
    assert not torch.equal(Shuffle(shift).carry(MESSAGE, EDGES, 0, step(18))[0], heard)


def test_two_robots_swap_and_one_alone_hears_itself():
    pair = torch.tensor([[[1.0], [2.0]]])
    heard, _ = Shuffle().carry(pair, EDGES[:1, :2, :2], 0, step(worlds=1, n_agents=2))
    assert heard.flatten().tolist() == [2, 1]
    alone, _ = Shuffle().carry(pair[:, :1], EDGES[:1, :1, :1], 0, step(worlds=1, n_agents=1))
    assert alone.flatten().tolist() == [1]


def test_frozen_messages_are_those_of_the_first_step_in_all_rounds():
    freeze = Freeze((2, 2))
    state = torch.zeros(4, 3, 5)
    messages = [(MESSAGE, -MESSAGE), (MESSAGE + 7, MESSAGE - 3), (MESSAGE * 2, MESSAGE * 3)]
    for rounds in messages:
        moment = step(state=state)
        for round_index, message in enumerate(rounds):
            heard, _ = freeze.carry(message, EDGES, round_index, moment)
            assert torch.equal(heard, messages[0][round_index])
        state = freeze.state_after(moment, rounds, [EDGES, EDGES])


def test_a_constant_message_is_the_mean_of_all_and_tells_no_robot_from_another():
    heard, edges = Mean().carry(MESSAGE, EDGES, 0, step())
    assert torch.equal(edges, EDGES) and heard.shape == MESSAGE.shape
    assert heard.flatten(0, -2).unique(dim=0).shape[0] == 1
    assert torch.allclose(heard[0, 0], MESSAGE.flatten(0, -2).mean(0))


def test_noise_is_as_large_as_messages_vary():
    message = torch.stack([torch.full((4_000, 3), 5.0), 10 * torch.randn(4_000, 3)], dim=-1)
    edges = torch.zeros(4_000, 3, 3, dtype=torch.bool)
    heard, _ = Noise().carry(message, edges, 0, step(worlds=4_000))
    assert torch.equal(heard[..., 0], message[..., 0])  # says the same always
    assert (heard - message)[..., 1].std().item() == pytest.approx(10, rel=0.05)


def test_no_noise_is_heard_from_silent_robots():
    message = torch.randn(50, 3, 4)
    message[:, 1] = 0
    edges = torch.zeros(50, 3, 3, dtype=torch.bool)
    moment = replace(step(worlds=50), gated=True)
    heard, _ = Noise().carry(message, edges, 0, moment)
    assert (heard[:, 1] == 0).all()
    assert (heard[:, ::2] != message[:, ::2]).all()


def policy_of(*settings: str):
    cfg = compose_config([*BASE, *settings])
    torch.manual_seed(0)
    agent = build.make_agent(cfg, build.make_env(cfg))
    for weight in agent.network.parameters():
        nn.init.normal_(weight, std=0.5)
    return cfg, agent.policy()


def played(cfg, policy, count: int = 5):
    return evaluate(
        cfg, lambda env: in_any_env(policy, env), house_set="test", count=count, seeded=True
    )


# All over several rounds and over gates; with the other schemes those that look into messages.
PLAYED = [(name, comm) for name in INTERVENTIONS for comm in ("tarmac", "ic3net")]
LOOKING = ("noise", "freeze", "delay")
PLAYED += [(name, comm) for name in LOOKING for comm in ("plan", "commnet", "dial")]


@pytest.mark.slow
@family(("name", "comm"), PLAYED, fast=[], usual=9)
def test_interventions_work_with_schemes(name, comm):
    cfg, policy = policy_of(f"comm={comm}")
    result = played(cfg, intervened(policy, INTERVENTIONS[name]), count=3)
    assert all(house["bits"] is not None for house in result)
    assert played(cfg, intervened(policy, INTERVENTIONS[name]), count=3) == result


@pytest.mark.slow
def test_shut_is_no_contact_and_open_is_full_contact():
    behaviour = ("T_90", "coverage", "return", "redundancy", "bumps")
    returns = set()
    for name, topology in (("shut", "none"), ("open", "full")):
        cfg, policy = policy_of("topology=view")
        other = cfg.copy()
        other.topology = compose_config([f"topology={topology}"]).topology
        changed = played(cfg, intervened(policy, INTERVENTIONS[name]))
        there = played(other, policy)
        for key in behaviour:
            assert [house[key] for house in changed] == [house[key] for house in there]
        returns.add(tuple(house["return"] for house in changed))
    assert len(returns) == 2  # it matters to this policy who is heard


@pytest.mark.slow
def test_the_untouched_policy_is_left_as_it_was():
    cfg, policy = policy_of()
    before = played(cfg, policy)
    intervened(policy, INTERVENTIONS["zero"])
    assert policy.network.stack == [] and played(cfg, policy) == before


def test_change_is_the_paired_difference():
    def entry(name, times):
        houses = [
            {"seed": i, "T_90": t, "max_steps": 90, "bound_90": 1} for i, t in enumerate(times)
        ]
        return make_entry(name, "test", "h", 0.0, 2, houses)

    result = change(entry("a | zero", [10, None, 30]), entry("a", [8, 88, 28]))
    assert result["T_90"] == {"mean": 2.0, "ci95": [2.0, 2.0]}


def test_deaf_robots_do_not_listen():
    value = torch.randn(6, 2, 4)
    result = differences_of(value, value.clone(), [value.clone() for _ in range(4)])
    assert all(not values.any() for values in result.values())


def test_listening_by_hand():
    value = torch.tensor([[[0.0, 1.0, 2.0, 4.0]]])
    zeros = torch.tensor([[[4.0, 1.0, 2.0, 0.0]]])
    result = differences_of(value, zeros, [value, zeros])
    assert result["zero_moved"].item() == 2.0 / 4.0 and result["zero_switched"].item() == 1
    weights = [math.exp(v) for v in (0, 1, 2, 4)]
    chance = [w / sum(weights) for w in weights]
    expected = 4 * (chance[3] - chance[0])  # the sum of p (log p - log p')
    assert result["zero_kl"].item() == pytest.approx(expected, abs=1e-5)
    assert result["shuffle_moved"].item() == 0


def test_a_robot_with_one_way_to_go_is_not_moved():
    shut = torch.finfo(torch.float32).min
    value = torch.tensor([[[shut, 3.0, shut, shut], [shut, 3.0, 1.0, shut]]])
    other = torch.tensor([[[shut, 9.0, shut, shut], [shut, 9.0, 1.0, shut]]])
    result = differences_of(value, other, [other])
    assert result["zero_moved"].tolist() == [[0.0, 6 / 2 / 2]]  # of two actions, their spread 2


def test_cic_of_a_robot_that_obeys_messages_is_their_entropy():
    obeying = [torch.tensor([[[100.0 * (a == k) for a in range(4)]]]) for k in (0, 1)]
    result = differences_of(obeying[0], obeying[0], obeying * 4)
    assert result["cic"].item() == pytest.approx(math.log(2), abs=1e-6)
    result = differences_of(obeying[0], obeying[0], [obeying[0]] * 8)
    assert result["cic"].item() == pytest.approx(0, abs=1e-9)


@pytest.mark.long
def test_robots_without_contact_are_not_counted():
    cfg, policy = policy_of("topology=none")
    result = listening(cfg, policy, count=3, epsilon=0.1)
    assert result["cic"] == {"mean": None, "ci95": None}
    cfg, policy = policy_of("topology=full")
    result = listening(cfg, policy, count=3, epsilon=0.1)
    assert result["zero_moved"]["mean"] > 0 and result["cic"]["mean"] > 0


@pytest.mark.slow
def test_names():
    assert named("all") == list(INTERVENTIONS)
    assert named("[zero,shut,zero]") == ["zero", "shut"]
    with pytest.raises(
        BadInput, match="intervention=shutt: no such intervention; did you mean shut"
    ):
        named("zero,shutt")
    for comm in ("none", "zeroed"):
        with pytest.raises(BadInput, match="send no messages"):
            communicating(policy_of(f"comm={comm}")[1], "x")


@pytest.mark.slow
def test_wrong_arguments_are_refused_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["evaluate", "planner=random", "intervention=zero"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "needs checkpoint=RUN" in error
    assert not list(tmp_path.iterdir())


def test_keys_of_the_frame_mark_frozen_messages():
    cfg, policy = policy_of("comm=commnet")
    frozen = intervened(policy, INTERVENTIONS["freeze"])
    assert keys.FROZEN in frozen.in_keys and ("next", *keys.FROZEN) in frozen.out_keys
