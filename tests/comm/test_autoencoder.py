"""`comm=autoencoder` is its equations, and what is read in messages gets into the hearers' maps."""

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.world.patches import CLEANED, NEVER_CLEANED, NUM_CLASSES, own_patches
from marl_clean.world.shared_map import is_unknown
from tests.comm.contract import make
from tests.families import family

SETTINGS = ["comm=autoencoder", "env.memory=private", "topology=full", "env.num_envs=4"]
SETTINGS += ["comm.sure=0.3", "comm.message_dim=16"]  # untrained, it is sure of nothing
SETTINGS += ["train_houses=8"]
STEPS = 30


def test_a_message_and_what_is_read_in_it_are_the_equations() -> None:
    comm = make("autoencoder", message_dim=5, hidden=7, sure=0.4)
    draw = torch.Generator().manual_seed(0)
    patch = torch.randint(NUM_CLASSES, (2, 3, 49), generator=draw).to(torch.int8)
    message = comm.code(patch)
    told = comm.patch_of(message)
    surprise = []
    for world in range(2):
        for robot in range(3):
            kinds = [int(kind) for kind in patch[world, robot]]
            x = torch.tensor([float(k == kind) for kind in kinds for k in range(4)]).double()
            sent = layers(comm.encoder, x)
            assert message[world, robot].tolist() == [1.0 if s >= 0 else -1.0 for s in sent]
            logits = layers(comm.decoder, message[world, robot])
            for cell, kind in enumerate(kinds):
                shares = logits[cell::49].softmax(0)
                best = int(shares.argmax())
                surprise.append(-shares[kind].log())
                assert int(told[world, robot, cell]) == (best if shares[best] >= 0.4 else 0)
    torch.testing.assert_close(comm.code_loss(patch), torch.stack(surprise).mean())
    assert 0 < (told > 0).sum() < told.numel()  # of some cells it is sure, of others not


def layers(part: torch.nn.Module, x: Tensor) -> Tensor:
    first, _, last = part.hidden
    hidden = (first.weight @ x + first.bias).clamp(min=0)
    return part.direct.weight @ x + part.direct.bias + last.weight @ hidden


@pytest.mark.slow
def test_a_code_learns_what_lies_around_robots() -> None:
    """Patches of one kind of two: one bit tells them apart."""
    comm = make("autoencoder", message_dim=1).train()
    patch = torch.full((8, 1, 49), CLEANED, dtype=torch.int8)
    patch[::2] = NEVER_CLEANED
    learner = torch.optim.Adam(comm.parameters(), lr=1e-2)
    for _ in range(60):
        learner.zero_grad()
        comm.code_loss(patch).backward()
        learner.step()
    assert torch.equal(comm.patch_of(comm.code(patch)), patch)


def talking(*further: str) -> tuple[TransformedEnv, torch.nn.Module]:
    cfg = compose_config([*SETTINGS, *further])
    env = build.make_env(cfg)
    torch.manual_seed(0)
    return env, build.make_agent(cfg, env).policy()


@family(
    ("channel", "settings", "heard"),
    [("lossy", ["channel.lossy.loss=1.0"], 0), ("quantised", [], 1), ("lossy", [], 0.8)],
    fast=[],
    usual=1,
)
def test_it_is_read_as_it_arrives(channel: str, settings: list[str], heard: float) -> None:
    def told(*over: str) -> tuple[Tensor, Tensor]:
        env, policy = talking("env.num_envs=64", "env.stuck_after=null", *over)
        frames = policy(env.reset())
        return frames[keys.TOLD_PATCH], frames[keys.TOLD_EDGES]

    patch, edges = told(f"channel={channel}", *settings)
    as_sent, contact = told()
    assert torch.equal(patch, as_sent)  # a loss is of an edge, and 4 bits hold -1 and 1
    assert abs(float(edges.sum() / contact.sum()) - heard) < 0.15
    assert not (edges & ~contact).any()


@pytest.mark.long
def test_what_was_read_is_seen_where_the_own_map_is_blank() -> None:
    env, policy = talking("env.stuck_after=null")
    td, more = env.reset(), 0
    for _ in range(STEPS):
        assert torch.equal(td[keys.PATCH], own_patches(env.state, env.rules.margin))
        td = env.step_and_maybe_reset(policy(td))[1]
        own, shown = env.base_env.state.own_record, env.base_env.state.record
        assert torch.equal(shown[own < 0], own[own < 0])  # walls it has met itself stay
        more += int((is_unknown(own) & ~is_unknown(shown)).sum())
    assert more > 0


@pytest.mark.long
def test_every_loop_hands_over_what_was_read() -> None:
    env, policy = talking()
    check_env_specs(env)
    env, _ = talking()
    td, frames = env.reset(), []
    for _ in range(STEPS):
        whole, td = env.step_and_maybe_reset(policy(td))
        frames.append(whole)
    expected = seen_in(torch.stack(frames, dim=1))
    assert torch.equal(seen_in(rollout(talking()[0], policy)), expected)
    for loop in (SerialEnv, ParallelEnv):
        envs = loop(1, make_talking_env)
        try:
            assert torch.equal(seen_in(rollout(envs, policy)[0]), expected)
        finally:
            envs.close()
    silent = talking("comm.sure=1.0")[0]
    assert not torch.equal(seen_in(rollout(silent, talking("comm.sure=1.0")[1])), expected)


def make_talking_env() -> TransformedEnv:
    return talking()[0]


def rollout(env: TransformedEnv, policy: torch.nn.Module) -> TensorDictBase:
    return env.rollout(STEPS, policy, break_when_any_done=False)


def seen_in(frames: TensorDictBase) -> Tensor:
    return frames[keys.OBSERVATION]


@pytest.mark.long
def test_robots_that_go_on_alone_hand_over_what_they_read_now() -> None:
    """Worlds end one after another: what the policy writes for the others must not be old."""
    env, policy = talking("house.rows=[5,9]", "house.cols=[5,6]", "house=open", "env.n_agents=2")
    ended = torch.zeros(4, dtype=torch.bool)
    draw = torch.Generator().manual_seed(0)

    def anything(action: Tensor) -> Tensor:
        return torch.randint(4, action.shape, generator=draw)

    for step in rollout_episodes(env, policy, first_frame(env, policy), explore=anything):
        rows = (~ended).nonzero()[:, 0]
        now = policy(step[rows].clone())  # of as many worlds: sums round by their number
        assert torch.equal(step[keys.TOLD_PATCH][rows], now[keys.TOLD_PATCH])
        assert torch.equal(step[keys.TOLD_PLACE][rows], step[keys.POSITION][rows])
        alone = len(rows)
        ended |= step["next", keys.DONE][:, 0]
    assert ended.all() and alone < len(ended)
