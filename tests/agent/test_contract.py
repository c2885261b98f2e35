"""Learners hold the contract, with schemes; each loss against plain arithmetic."""

import copy

import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical

from marl_clean import keys
from marl_clean.agent.iql import Iql
from marl_clean.agent.vdn import Vdn
from marl_clean.config import levels
from marl_clean.config.class_source import constant
from marl_clean.learning.acting import entries
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.ppo import Ppo
from marl_clean.testing import ContractBroken, check_agent
from tests.agent.parts import IQL, LEARNERS, STATE_SHAPE, make_learner, transitions
from tests.families import family, world_for

SCHEMES = levels.rooms()["comm"]


def fitting() -> list[tuple[str, str]]:
    """Two learners with every scheme, each other one with silence and with talk.

    Learners meet schemes only through their network, which is the same for all that act by values
    and for all that act by policies.
    """
    pairs = []
    for learner in LEARNERS:
        target = OmegaConf.load(levels.conf_folder() / "agent" / f"{learner}.yaml")["_target_"]
        valid = (constant(target, "fits") or {}).get("comm", SCHEMES)
        chosen = SCHEMES if learner in ("iql", "ippo") else ("none", "plan")
        pairs += [(learner, scheme) for scheme in chosen if scheme in valid]
    return pairs


def batch_for(agent, count: int = 6, seed: int = 0) -> TensorDict:
    """What the agent learns from; rows of 3 frames if it unrolls."""
    batch = transitions(count * 3, seed=seed)
    batch[keys.STATE] = torch.rand(len(batch), *STATE_SHAPE) < 0.5
    batch["next", keys.STATE] = torch.rand(len(batch), *STATE_SHAPE) < 0.5
    batch[keys.LOG_PROB] = torch.rand(len(batch), 2).log()
    batch[keys.ADVANTAGE] = torch.randn(len(batch), 2, 1)
    batch[keys.VALUE_TARGET] = torch.randn(len(batch), 2, 1)
    batch[keys.IS_INIT] = torch.rand(len(batch), 1) < 0.3
    if isinstance(agent, Ppo):
        names = (*agent.learns_from[: len(agent.network.sees)], keys.ACTION, keys.LOG_PROB)
        kept = (*names, keys.ADVANTAGE, keys.VALUE_TARGET, keys.IS_INIT)
    else:
        kept = (*agent.learns_from, keys.STEPS_TO_NEXT_OBS)
    network = agent.network
    for key, spec in (network.state_specs(2) if hasattr(network, "carries") else {}).items():
        batch[key] = spec.rand([len(batch)])
        batch["next", key] = spec.rand([len(batch)])
    batch = batch.select(*kept, strict=False)
    return batch.view(count, 3) if agent.unrolls else batch


@family(("learner", "scheme"), fitting(), fast=[("iql", "plan"), ("ippo", "none")], usual=16)
def test_the_contract(learner: str, scheme: str) -> None:
    check_agent(learner, comm=scheme, others=world_for(scheme), precision="float32")


IN_A_ROW = [(learner, "encoder.memory=gru") for learner in LEARNERS if learner != "central_dqn"]
IN_A_ROW += [("iql", "channel=delayed"), ("ippo", "channel=delayed")]  # rows as before, more keys


@family(("learner", "memory"), IN_A_ROW, fast=1, usual=4)
def test_the_contract_with_frames_in_a_row(learner: str, memory: str) -> None:
    check_agent(learner, others=[memory], precision="float32")


class Frozen(Iql):
    def update(self, batch):
        return {"loss": self.loss(self._frames_to_learn(batch)).detach()}


class Forgetful(Iql):
    def load_state_dict(self, state):
        super().load_state_dict({**state, "optimiser": self._optimiser.state_dict()})


class Copying(Iql):
    def policy(self):
        return copy.deepcopy(super().policy())


class WithGraph(Iql):
    def update(self, batch):
        measured = super().update(batch)
        weight = next(self.network.parameters())
        return {**measured, "weight": weight.sum()}


class Undrawn(Iql):
    count = 0

    def update(self, batch):
        Undrawn.count += 1
        batch["next", keys.REWARD] = batch["next", keys.REWARD] + Undrawn.count
        return super().update(batch)


class AllAlike(Iql):
    def exploration(self, action_spec):
        def same(action):
            return action[..., :1].expand_as(action).clone()

        module = TensorDictModule(same, in_keys=[keys.ACTION], out_keys=[keys.ACTION])
        return TensorDictSequential(super().exploration(action_spec), module)


@family(
    ("wrong", "broken"),
    [
        (Frozen, "an update moves no weight of the network"),
        (Forgetful, "after an update from the same state, other weights, in .*: at"),
        (Copying, "acts by other weights: at"),
        (WithGraph, "update measures weight with its graph"),
        (Undrawn, "from the same frames, another loss:"),
        (AllAlike, "exploring, all robots act alike"),
    ],
    fast=2,
)
def test_the_contract_refuses(wrong: type[Iql], broken: str) -> None:
    with pytest.raises(ContractBroken, match=f"^agent={wrong.__name__} .*{broken}"):
        check_agent(wrong, **IQL)


def team_loss(agent: Vdn, batch: TensorDict, mixed) -> torch.Tensor:
    """Double Q of the team's value, written out."""
    now, then = (entries(agent.network, part) for part in (batch, batch["next"]))
    target = copy.deepcopy(agent.network)
    target.load_state_dict(
        {n: w for n, w in agent.state_dict()["target"].items() if "mixer_network" not in n}
    )
    with torch.no_grad():
        best = agent.network(then).out.argmax(-1, keepdim=True)
        later = mixed(target(then).out.gather(-1, best), batch["next", keys.STATE])
        continues = (~batch["next", "terminated"]).float()
        reward = batch["next", keys.REWARD][:, 0]  # the sum already, the same for all
        discount = agent.gamma ** batch[keys.STEPS_TO_NEXT_OBS].unsqueeze(-1)
        goal = reward + discount * continues * later
    chosen = agent.network(now).out.gather(-1, batch[keys.ACTION].unsqueeze(-1))
    return torch.nn.functional.smooth_l1_loss(mixed(chosen, batch[keys.STATE]), goal)


def team_batch() -> TensorDict:
    batch = transitions(32)
    batch[keys.STATE] = torch.rand(32, *STATE_SHAPE) < 0.5
    batch["next", keys.STATE] = torch.rand(32, *STATE_SHAPE) < 0.5
    reward = batch["next", keys.REWARD]
    batch["next", keys.REWARD] = reward.sum(1, keepdim=True).expand_as(reward).clone()
    return batch


def moved(learner: str, kind=None) -> DeepQ:
    """A learner whose target network is no longer its network."""
    agent = make_learner(learner, "plan", lr=0.03, lr_end=0.03)
    if kind is not None:
        agent.__class__ = kind
    for step in range(3):
        agent.update(batch_for(agent, seed=step))
    return agent


@pytest.mark.slow
def test_vdn_adds_values_and_rewards_up():
    agent, batch = moved("vdn"), team_batch()
    expected = team_loss(agent, batch, lambda values, state: values.sum(1))
    torch.testing.assert_close(agent.update(batch)["loss"], expected.detach())


@pytest.mark.slow
def test_qmix_mixes_by_the_state():
    agent, batch = moved("qmix"), team_batch()
    mixer = copy.deepcopy(agent.learnt["mixer_network"].module)
    online = dict(mixer.named_parameters())
    held = {
        n.removeprefix("mixer_network.module."): w
        for n, w in agent.state_dict()["target"].items()
        if "mixer_network" in n
    }
    assert held.keys() == online.keys()

    def mixed(values, state):
        # The next frame is mixed by the target mixer: told apart by whose values have no gradient.
        weights = online if values.requires_grad else held
        return torch.func.functional_call(mixer, weights, (values, state.float()))

    expected = team_loss(agent, batch, mixed).detach()
    torch.testing.assert_close(agent.update(batch)["loss"], expected)


def test_mixing_is_monotonous():
    agent = moved("qmix")
    values = torch.randn(20, 2, 1, requires_grad=True)
    state = (torch.rand(20, *STATE_SHAPE) < 0.5).float()
    (grad,) = torch.autograd.grad(agent.learnt["mixer_network"].module(values, state).sum(), values)
    assert (grad >= 0).all() and grad.any()


class MeanOfRewards(Vdn):
    def reward(self, frames):
        return super().reward(frames) / self.n_agents


class NeverEnds(Vdn):
    def loss(self, frames):
        frames["next", "terminated"] = torch.zeros_like(frames["next", "terminated"])
        return super().loss(frames)


class ChosenByTheTarget(Vdn):
    def update(self, batch):
        self.double = False
        return super().update(batch)


@pytest.mark.parametrize("defect", [MeanOfRewards, NeverEnds, ChosenByTheTarget])
def test_planted_defects_of_the_team_value_are_seen(defect):
    agent, batch = moved("vdn", defect), team_batch()
    expected = team_loss(agent, batch, lambda values, state: values.sum(1)).detach()
    assert not torch.allclose(agent.update(batch)["loss"], expected)


def block_of_one_world() -> tuple[list, list, list, TensorDict]:
    """Five steps: cut off after the second, ended after the fourth."""
    rewards = [[1.0, -1.0], [0.5, 2.0], [0.0, 1.0], [3.0, 0.0], [-1.0, 1.0]]
    terminated = [False, False, False, True, False]
    done = [False, True, False, True, False]
    block = transitions(5)
    for t in (0, 2):  # what is behind a frame is the next one, but where an episode ends
        block["next", keys.OBSERVATION][t] = block[keys.OBSERVATION][t + 1]
    block["next", keys.REWARD] = torch.tensor(rewards).unsqueeze(-1)
    block["next", keys.DONE] = torch.tensor(done).unsqueeze(-1)
    block["next", keys.TERMINATED] = torch.tensor(terminated).unsqueeze(-1)
    block[keys.LOG_PROB] = torch.rand(5, 2).log()
    return rewards, terminated, done, block.unsqueeze(0)


@pytest.mark.parametrize("learner", ["ippo", "mappo"])
def test_advantages_bootstrap_what_is_cut_and_not_what_ends(learner):
    agent = make_learner(learner, "plan")
    rewards, terminated, done, block = block_of_one_world()
    estimated = agent.estimate(block)
    with torch.no_grad():
        value = agent.critic(block[keys.OBSERVATION])[0, :, :, 0].tolist()
        later = agent.critic(block["next", keys.OBSERVATION])[0, :, :, 0].tolist()
    gamma, lmbda = agent.gamma, 0.9
    for robot in range(2):
        advantage = 0.0
        for t in reversed(range(5)):
            bootstrap = 0.0 if terminated[t] else gamma * later[t][robot]
            delta = rewards[t][robot] + bootstrap - value[t][robot]
            advantage = delta + (0.0 if done[t] else gamma * lmbda * advantage)
            assert estimated[keys.ADVANTAGE][0, t, robot, 0].item() == pytest.approx(
                advantage, abs=1e-5
            )
            target = estimated[keys.VALUE_TARGET][0, t, robot, 0].item()
            assert target == pytest.approx(advantage + value[t][robot], abs=1e-5)


def clipped_loss(agent: Ppo, batch: TensorDict, epsilon: float = 0.2) -> torch.Tensor:
    """PPO's loss, written out."""
    logits = agent.network(entries(agent.network, batch)).out
    drawn = Categorical(logits=logits)
    ratio = (drawn.log_prob(batch[keys.ACTION]) - batch[keys.LOG_PROB]).exp().unsqueeze(-1)
    advantage = batch[keys.ADVANTAGE]
    gain = torch.minimum(ratio * advantage, ratio.clamp(1 - epsilon, 1 + epsilon) * advantage)
    value = agent.critic(batch[keys.OBSERVATION])
    critic = torch.nn.functional.smooth_l1_loss(value, batch[keys.VALUE_TARGET])
    return -gain.mean() + 0.5 * critic - 0.01 * drawn.entropy().mean()


@pytest.mark.parametrize("learner", ["ippo", "mappo"])
def test_the_clipped_loss_by_hand(learner):
    agent = make_learner(learner, "plan", normalize_advantage=False)
    batch = batch_for(agent, count=10)
    expected = clipped_loss(agent, batch).detach()
    assert not torch.allclose(expected, clipped_loss(agent, batch, epsilon=1e9).detach())
    torch.testing.assert_close(agent.update(batch.clone())["loss"], expected)


def test_only_the_central_critic_knows_what_others_see():
    observation = transitions(4)[keys.OBSERVATION]
    other = observation.clone()
    other[:, 1] = observation.flip(0)[:, 1]
    for learner, knows in (("ippo", False), ("mappo", True)):
        critic = make_learner(learner, "plan").critic
        same = torch.equal(critic(observation)[:, 0], critic(other)[:, 0])
        assert same is not knows
