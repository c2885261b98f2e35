"""One episode as scenes, to be shown in a GIF, in the terminal or in a figure."""

from collections.abc import Iterator

from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import step_mdp

from marl_clean import build
from marl_clean.config.stored import find_run
from marl_clean.env.scene import scene_of
from marl_clean.env.viewer import Scene
from marl_clean.evaluation.evaluator import PolicyFor, exploring, held_out_env
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.keys import ADJACENCY


def policy_of(cfg: DictConfig) -> PolicyFor:
    """The policy that a command is asked to show: `cfg.checkpoint`'s, else `cfg.planner`."""
    if cfg.checkpoint is None:
        return lambda env: build.make_planner(cfg, env)
    policy = build.load_policy(find_run(cfg.checkpoint), cfg).to(cfg.device)
    return lambda env: policy


def first_held_out(cfg: DictConfig) -> TransformedEnv:
    """The first held-out house alone, started as in an evaluation."""
    house_set = cfg.evaluation.house_set
    return held_out_env(cfg, build.held_out_houses(cfg, house_set, 1), house_set, num_envs=1)


def rollout(
    env: TransformedEnv, policy_for: PolicyFor, epsilon: float = 0.0
) -> Iterator[TensorDictBase]:
    """The tensordicts of one episode of a single house, from the reset to the last step.

    They share the env's state: read it before the next step is requested.
    """
    policy = policy_for(env)
    first = first_frame(env, policy)
    yield first
    for step in rollout_episodes(env, policy, first, explore=exploring(env.base_env, epsilon)):
        yield step_mdp(step)


def scenes(env: TransformedEnv, policy_for: PolicyFor, epsilon: float = 0.0) -> Iterator[Scene]:
    """Every step of one episode, from step 0 to the end."""
    base = env.base_env
    for td in rollout(env, policy_for, epsilon):
        yield scene_of(base.state, base.rules, 0, td[ADJACENCY])
