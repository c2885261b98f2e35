"""Any policy on an external task: its return over seeded episodes, since there are no houses.

Episode i is that of env i, with the same seed for every policy. As in houses, nothing here draws
from a global generator.
"""

from collections.abc import Mapping
from itertools import count
from typing import Any

import torch
from jaxtyping import Bool, Int
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs import TransformedEnv

from marl_clean import build, keys
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import level_of
from marl_clean.evaluation.records import Entry, make_entry
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.world.random import Purpose, random_below, random_bits

RANDOM = "random"


def measure_return(cfg: DictConfig, policy: nn.Module | None, name: str, seed: int) -> Entry:
    """One entry of evaluation.json, of `cfg.evaluation.houses` episodes with their own seeds.

    A record holds the seed that the task was reset with, the steps, and the return: the sum of
    what all agents earned themselves. Without a policy all actions are random.
    """
    episodes, epsilon = cfg.evaluation.houses, cfg.evaluation.epsilon
    share = 1.0 if policy is None else epsilon
    records: list[Mapping[str, Any]] = []
    for first in range(0, episodes, cfg.env.num_envs):  # as many at once as in training
        num_envs = min(cfg.env.num_envs, episodes - first)
        env = build.make_env(cfg, num_envs=num_envs, first_env=first)
        records += run_episodes(env, policy, share, seed)
        env.close()
    explored = 0.0 if policy is None else epsilon  # as for planners, which do not explore
    task = cfg.env.get("task", level_of(cfg.env._target_))
    entry = make_entry(name, task, config_hash(cfg), explored, env.base_env.n_agents, records)
    return {**entry, "world": None}  # its rules are not ours


def run_episodes(
    env: TransformedEnv, policy: nn.Module | None, epsilon: float, seed: int
) -> list[dict[str, int | float]]:
    """One episode in every env, with a share of random actions; the records in their order."""
    base = env.base_env
    env.set_seed(seed)
    spec = env.full_action_spec[keys.ACTION]
    steps = torch.zeros(base.num_envs, dtype=torch.int64)
    total = torch.zeros(base.num_envs, dtype=torch.float64)
    words = (base.env_index[:, None], Purpose.ACTION, torch.arange(base.n_agents))
    step = count()

    def explore(action: Int[Tensor, "env agent"]) -> Int[Tensor, "env agent"]:
        index = next(step)
        drawn = random_below(spec.n, seed, *words, index, 1).to(spec.device)
        explores = random_bits(seed, *words, index, 0).to(spec.device) < round(epsilon * 2**32)
        return torch.where(explores, drawn, action)

    chosen = ZeroActions(spec) if policy is None else policy
    first = first_frame(env, chosen)
    seeds, running = base.episode_seeds, ~first[keys.DONE].flatten().cpu()
    for frame in rollout_episodes(env, chosen, first, act=_act, explore=explore, resets=True):
        earned = frame["next", keys.OWN_REWARD].sum((1, 2)).double().cpu()
        total += torch.where(running, earned, 0.0)
        steps += running
        running &= ~frame["next", keys.DONE].flatten().cpu()
    rows = zip(seeds.tolist(), steps.tolist(), total.tolist(), strict=True)
    return [dict(zip(("seed", "steps", "return"), row, strict=True)) for row in rows]


class ZeroActions(nn.Module):
    """Action 0 of all robots, for exploration to replace."""

    def __init__(self, spec: TensorSpec) -> None:
        super().__init__()
        self.spec = spec

    def forward(self, td: TensorDictBase) -> TensorDictBase:
        return td.set(keys.ACTION, self.spec.zero())


def _act(policy: nn.Module, td: TensorDictBase, running: Bool[Tensor, " env"]) -> TensorDictBase:
    """Act in all envs: those that ended go on, in episodes that are not counted."""
    return policy(td)
