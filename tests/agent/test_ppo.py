"""Options of PPO: a falling entropy bonus, a head of zeros, sampled actions, other critics."""

import pytest
import torch
from omegaconf import OmegaConf
from torch.distributions import Categorical

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import check_fit
from marl_clean.config.stored import compose_for_policy
from marl_clean.errors import BadInput
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.learning import acting
from marl_clean.learning.acting import entries
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.testing import agent as contract
from marl_clean.testing import check_agent
from tests.agent.parts import STATE_SHAPE, collected, make_learner, transitions
from tests.families import family

SMALL = (*contract.SMALL, "agent=ippo", "trainer=on_policy", "agent.precision=float32")
SIZES = ("house=open", "house.rows=[3,4]", "house.cols=[3,5]", "train_houses=6")


def played(*settings: str):
    """A learner, and a block that it collected, of episodes of at most 5 steps."""
    return collected([*SMALL, *SIZES, *settings])


def test_the_bonus_falls_linearly_and_is_in_the_loss() -> None:
    agent = make_learner("ippo", "plan", entropy_coeff=0.2, entropy_coeff_end=0.1)
    batch = transitions(10)
    batch[keys.LOG_PROB] = torch.rand(10, 2).log()
    batch[keys.ADVANTAGE] = torch.randn(10, 2, 1)
    batch[keys.VALUE_TARGET] = torch.randn(10, 2, 1)
    losses = []
    for progress in (0.0, 0.5, 1.0):
        agent.anneal(progress)
        losses.append(agent._loss(batch.clone())["loss_entropy"])
    entropy = Categorical(logits=agent.network(entries(agent.network, batch)).out).entropy().mean()
    expected = -entropy * torch.tensor([0.2, 0.15, 0.1])
    torch.testing.assert_close(torch.stack(losses), expected)


@pytest.mark.slow
def test_without_an_end_the_bonus_stays() -> None:
    agent = make_learner("mappo", "plan")
    agent.anneal(1.0)
    assert agent._loss.entropy_coeff.item() == pytest.approx(0.01)


def test_a_head_of_zeros_makes_all_actions_equally_likely_and_nothing_else() -> None:
    zero, plain = (make_learner("ippo", "plan", zero_head=flag) for flag in (True, False))
    logits = zero.network(entries(zero.network, transitions(5))).out
    assert not logits.any()
    for name, weight in plain.network.state_dict().items():
        assert torch.equal(zero.network.state_dict()[name], weight) is ("head" not in name)


def test_actions_are_drawn_by_softmax_from_seeds_alone() -> None:
    logits = torch.tensor([2.0, 0.0, -1.0, torch.finfo(torch.float32).min])
    seed = torch.randint(2**32, (40_000, 2), generator=torch.Generator().manual_seed(0))
    action = acting.drawn(logits.expand(40_000, 2, 4), seed)
    assert torch.equal(action, acting.drawn(logits.expand(40_000, 2, 4), seed))
    for robot in (0, 1):
        share = action[:, robot].bincount(minlength=4) / 40_000
        torch.testing.assert_close(share, logits.softmax(0), atol=0.01, rtol=0)
    both = (action[:, 0] == action[:, 1]).float().mean()
    assert both.item() == pytest.approx(logits.softmax(0).square().sum().item(), abs=0.01)


@pytest.mark.slow
def test_sampled_actions_are_repeatable_and_differ_from_argmax() -> None:
    records = {}
    for play in ("argmax", "sampled"):
        config = compose_config([*SMALL, *SIZES, f"agent.play={play}", "agent.zero_head=true"])
        torch.manual_seed(0)
        agent = build.make_agent(config, build.make_env(config))
        policy = agent.policy()
        first, again = (
            evaluate(config, lambda env, it=policy: it, house_set="validation", count=6)
            for _ in range(2)
        )
        assert first == again
        records[play] = [record["bumps"] for record in first]
    assert records["argmax"] != records["sampled"]


def test_an_env_that_does_not_draw_is_named() -> None:
    config = compose_config([*SMALL, *SIZES])
    env = build.make_env(config)
    config.agent.play = "sampled"
    with pytest.raises(BadInput, match="channel_seed"):
        build.make_agent(config, env).policy()(env.reset())


@family("critic", ["local", "robots", "state"], fast=["state"])
@family("memory", ["none", "gru"], fast=["gru"])
def test_the_contract_with_other_critics(critic: str, memory: str) -> None:
    check_agent("ippo", precision="float32", critic=critic, critic_memory=memory)


@pytest.mark.slow
def test_the_contract_with_normalised_values() -> None:
    check_agent("ippo", precision="float32", normalize_value=True, critic_memory="gru")


@pytest.mark.slow
def test_normalised_values_are_in_units_of_the_reward_and_soon_of_its_size() -> None:
    batch = transitions(10)
    batch[keys.LOG_PROB] = torch.full((10, 2), 0.25).log()
    batch[keys.ADVANTAGE] = torch.zeros(10, 2, 1)
    batch[keys.VALUE_TARGET] = torch.tensor([250.0, 350.0]).view(1, 2, 1).expand(10, 2, 1).clone()
    errors = {}
    for normalises in (True, False):
        torch.manual_seed(0)
        agent = make_learner("ippo", "plan", normalize_value=normalises)
        for _ in range(20):
            loss = agent.update(batch.clone())["loss_critic"]
        value = agent.critic(batch[keys.OBSERVATION])
        errors[normalises] = (value - batch[keys.VALUE_TARGET]).abs().mean().item()
    assert loss > 100 and errors[False] > 250  # a network as it is initialised is near 0
    assert errors[True] < 55


@pytest.mark.slow
def test_the_contract_with_sampled_actions() -> None:
    check_agent("mappo", precision="float32", play="sampled", zero_head=True)


@pytest.mark.parametrize("critic", ["local", "robots", "state"])
def test_which_robots_a_critic_depends_on(critic: str) -> None:
    valuing = make_learner("ippo", "plan", critic=critic).critic
    seen = transitions(4)[keys.OBSERVATION]
    states = torch.rand(2, 4, *STATE_SHAPE) < 0.5
    states[1] = ~states[0]
    other = seen.clone()
    other[:, 1] = seen.flip(0)[:, 1]
    known = [[], []] if critic != "state" else [[states[0]], [states[1]]]
    value = valuing(seen, *known[0])[:, 0]
    assert torch.equal(value, valuing(other, *known[0])[:, 0]) is (critic != "robots")
    assert torch.equal(value, valuing(seen, *known[1])[:, 0]) is (critic != "state")


@family("critic", ["local", "state"], fast=["local"])
def test_a_critics_memory_goes_through_episodes_and_from_block_to_block(critic: str) -> None:
    agent, frames = played(f"agent.critic={critic}", "agent.critic_memory=gru")
    valuing, begins = agent.critic, frames[keys.IS_INIT]
    assert begins[:, 1:].any()
    with torch.no_grad():
        feature = valuing.features(*(frames[key] for key in valuing.sees))
        behind = valuing.features(*(frames["next", key] for key in valuing.sees))
    expected = torch.zeros(4, 12, 3, 1)
    later = torch.zeros_like(expected)
    for env in range(4):
        for robot in range(3):
            hidden = torch.zeros(1, feature.shape[-1])
            for t in range(12):
                if begins[env, t]:
                    hidden = torch.zeros_like(hidden)
                with torch.no_grad():
                    hidden = valuing.memory(feature[env, t, robot][None], hidden)
                    expected[env, t, robot] = valuing.head(hidden)[0]
                    after = valuing.memory(behind[env, t, robot][None], hidden)
                    later[env, t, robot] = valuing.head(after)[0]
    for block in (frames[:, :7], frames[:, 7:]):
        part = block.select(*agent.learns_from)
        with torch.no_grad():
            agent._value_(part)
        start = 0 if len(part[0]) == 7 else 7
        span = slice(start, start + part.shape[1])
        torch.testing.assert_close(part[keys.STATE_VALUE], expected[:, span])
        torch.testing.assert_close(part["next", keys.STATE_VALUE], later[:, span])


@pytest.mark.slow
def test_an_external_task_has_no_true_state() -> None:
    spread = compose_config(["+experiment=spread"])
    by_ppo = compose_config([*SMALL[-3:]])
    spread.agent, spread.trainer = by_ppo.agent, by_ppo.trainer
    check_fit(spread)
    spread.agent.critic = "state"
    with pytest.raises(BadInput, match=r"^agent.critic=state: env=pettingzoo shows no true state"):
        check_fit(spread)


@pytest.mark.slow
def test_any_weights_act_by_the_settings_of_the_config(tmp_path) -> None:
    config = compose_config([*SMALL, *SIZES, "name=mine"])
    agent = build.make_agent(config, build.make_env(config))
    folder = tmp_path / "mine"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
    Checkpoints(folder / FOLDER).save("best", 1, agent.network.state_dict(), {"T_100": 1.0})
    changes = ["agent.mask_walls=true", "agent.play=sampled"]
    wanted = compose_for_policy([f"checkpoint={folder}", *changes])
    policy, own = build.load_policy(folder, wanted), build.load_policy(folder)
    assert policy.draws and policy.network.mask_walls
    assert not own.draws and not own.network.mask_walls
    assert policy(build.make_env(wanted).reset())[keys.ACTION].shape == (4, 3)
