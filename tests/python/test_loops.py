"""A policy and an env that go together act alike in every TorchRL loop, or one line says why not.

The run's robots remember, talk late and lose messages in bursts: three things to be carried.
"""

from collections.abc import Callable
from functools import partial

import pytest
import torch
from jaxtyping import Float
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import (
    EnvBase,
    FrameSkipTransform,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs, step_mdp

import marl_clean
from marl_clean import BadInput, Run, build, keys
from marl_clean.config.compose import compose_config
from marl_clean.learning.acting import begin_carrying
from marl_clean.python.keywords import overrides_of
from marl_clean.python.measuring import config_for_policy

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]  # a run is trained

STEPS, WORLDS = 12, 3
LONG = {"num_envs": WORLDS, "max_steps": 5}  # several episodes in a rollout

Values = Float[Tensor, "env time agent action"]


@pytest.fixture(scope="module")
def values(run: Run) -> Values:
    """What evaluation's own way of carrying gives, without a primer, reset by hand."""
    env = bare(run)
    assert keys.HIDDEN not in env.observation_spec.keys(True, True)
    td = begin_carrying(run.policy, env.reset())
    seen = []
    with torch.no_grad():
        for _ in range(STEPS):
            td = env.step(run.policy(td))
            seen.append(td[keys.ACTION_VALUE])
            done = td["next", keys.DONE]
            td = step_mdp(td)
            if done.any():
                assert done.all()  # all at max_steps
                td = begin_carrying(run.policy, env.reset())
    return torch.stack(seen, dim=1)


def bare(run: Run) -> TransformedEnv:
    """The run's world without what its policy carries."""
    settings = overrides_of(None, {"checkpoint": run.folder, **LONG})
    return build.make_env(config_for_policy(settings))


def by_rollout(run: Run) -> Tensor:
    return run.env(**LONG).rollout(STEPS, run.policy, break_when_any_done=False)[keys.ACTION_VALUE]


def by_steps(run: Run) -> Tensor:
    env, seen = run.env(**LONG), []
    td = env.reset()
    for _ in range(STEPS):
        whole, td = env.step_and_maybe_reset(run.policy(td))
        seen.append(whole[keys.ACTION_VALUE])
    return torch.stack(seen, dim=1)


def by_collector(run: Run, env: EnvBase | None = None) -> Tensor:
    collector = Collector(
        env or run.env(**LONG),
        run.policy,
        frames_per_batch=STEPS * WORLDS,
        total_frames=STEPS * WORLDS,
        auto_register_policy_transforms=True,
    )
    [frames] = list(collector)
    return frames[keys.ACTION_VALUE]


def by_batch_of(kind: type[EnvBase], count: int, run: Run) -> Tensor:
    env = kind(count, partial(env_of, str(run.folder.resolve())))
    try:
        played = env.rollout(STEPS, run.policy, break_when_any_done=False)[keys.ACTION_VALUE]
    finally:
        env.close()
    assert all(torch.equal(played[0], other) for other in played)
    return played[0]


def env_of(run: str) -> EnvBase:
    return Run(run).env(**LONG)


@pytest.mark.parametrize(
    "loop",
    [
        by_rollout,
        by_steps,
        by_collector,
        lambda run: by_collector(run, bare(run)),  # which asks the policy for its primer
        partial(by_batch_of, SerialEnv, 2),
        pytest.param(partial(by_batch_of, ParallelEnv, 1), marks=pytest.mark.long),
    ],
    ids=["rollout", "step_and_maybe_reset", "Collector", "bare Collector", "Serial", "Parallel"],
)
def test_every_loop_carries_alike(run: Run, values: Values, loop: Callable[[Run], Tensor]) -> None:
    with torch.no_grad():
        played = loop(run)
    torch.testing.assert_close(played, values, rtol=0, atol=1e-6)
    assert (values[:, 1] - values[:, 0]).abs().max() > 0


@pytest.mark.parametrize("kind", ["rollout", "step_and_maybe_reset", "Serial"])
def test_a_loop_that_would_lose_what_is_carried_is_refused(run: Run, kind: str) -> None:
    env: EnvBase = bare(run)
    if kind == "Serial":
        env = SerialEnv(1, lambda: bare(run))
    with pytest.raises(BadInput, match=r"env.append_transform\(policy.make_tensordict_primer"):
        if kind == "step_and_maybe_reset":
            env.step_and_maybe_reset(run.policy(env.reset()))
        else:
            env.rollout(6, run.policy)


def test_the_env_of_a_checkpoint_is_the_runs_own(run: Run) -> None:
    for env in (marl_clean.make_env(["checkpoint=mine"]), marl_clean.make_env(checkpoint="mine")):
        assert env.batch_size == (8,) and env.base_env.n_agents == 2
        assert env.observation_spec[keys.OBSERVATION].shape[-1] == 7
        assert env.observation_spec == run.env().observation_spec
        env.rollout(3, marl_clean.load_policy("mine"))
    check_env_specs(env)


def test_a_policy_in_an_env_that_does_not_fit_names_both(run: Run) -> None:
    other = marl_clean.make_env(num_envs=2, view_size=9, train_houses=2)
    other.append_transform(run.policy.make_tensordict_primer())
    with pytest.raises(BadInput, match="channel_seed"):
        other.rollout(2, run.policy)
    drawing = marl_clean.make_env(num_envs=2, view_size=9, train_houses=2, channel="lossy")
    drawing.append_transform(run.policy.make_tensordict_primer())
    with pytest.raises(BadInput, match=r"\[1, 7, 7\] .* \[1, 9, 9\]"):
        drawing.rollout(2, run.policy)


def test_a_policy_of_robots_together_names_both_numbers() -> None:
    world = ["observation.view_size=7", "train_houses=2", "env.num_envs=2", "reward=team"]
    config = compose_config([*world, "agent=central_dqn", "comm=none"])
    policy = build.make_agent(config, build.make_env(config)).policy()
    with pytest.raises(BadInput, match="env.n_agents=3: the policy is of 2 robots"):
        marl_clean.make_env([*world, "env.n_agents=3"]).rollout(2, policy)


def test_there_is_one_reward_for_what_asks_for_one(run: Run) -> None:
    env = run.env(num_envs=2)
    assert env.reward_keys == [keys.REWARD] and env.reward_key == keys.REWARD
    skipping = TransformedEnv(run.env(num_envs=2), FrameSkipTransform(2))
    played = skipping.rollout(3, run.policy)
    assert played["next", keys.REWARD].shape == (2, 3, 2, 1)
    summed = TransformedEnv(run.env(num_envs=2), RewardSum())  # by its defaults
    assert (keys.AGENTS, "episode_reward") in summed.rollout(3, run.policy)["next"].keys(True)
