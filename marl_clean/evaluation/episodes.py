"""Any policy on a task of others: its return over seeded episodes, for want of houses.

Episode i is that of env i, with the same seed for every policy. As in houses, nothing here draws
from a global generator.
"""

from collections.abc import Mapping
from typing import Any

import torch
from omegaconf import DictConfig
from torch import nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from marl_clean import build, keys
from marl_clean.config.config_hash import config_hash
from marl_clean.evaluation.records import Entry, make_entry
from marl_clean.learning.acting import begin_carrying
from marl_clean.world.random import Purpose, random_below, random_bits

RANDOM = "random"


def measure_return(cfg: DictConfig, policy: nn.Module | None, name: str, seed: int) -> Entry:
    """One entry of evaluation.json, of `cfg.evaluation.houses` episodes with their own seeds.

    A record holds the seed that the task was reset with, the steps, and the return: the sum of
    what all agents earned themselves. Without a policy all actions are random.
    """
    count, epsilon = cfg.evaluation.houses, cfg.evaluation.epsilon
    share = 1.0 if policy is None else epsilon
    records: list[Mapping[str, Any]] = []
    for first in range(0, count, cfg.env.num_envs):  # as many at once as training plays
        num_envs = min(cfg.env.num_envs, count - first)
        env = build.make_env(cfg, num_envs=num_envs, first_env=first)
        records += play(env, policy, share, seed)
        env.close()
    told = 0.0 if policy is None else epsilon  # as of planners: they do not explore
    entry = make_entry(name, cfg.env.task, config_hash(cfg), told, env.base_env.n_agents, records)
    return {**entry, "world": None}  # its rules are not ours


def play(
    env: TransformedEnv, policy: nn.Module | None, epsilon: float, seed: int
) -> list[dict[str, int | float]]:
    """One episode in every env, with a share of random actions; the records in their order."""
    base = env.base_env
    env.set_seed(seed)
    spec = env.full_action_spec[keys.ACTION]
    steps = torch.zeros(base.num_envs, dtype=torch.int64)
    total = torch.zeros(base.num_envs, dtype=torch.float64)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        td = env.reset() if policy is None else begin_carrying(policy, env.reset())
        seeds = base.episode_seeds
        playing = ~td[keys.DONE].flatten().cpu()
        words = (base.env_index[:, None], Purpose.ACTION, torch.arange(base.n_agents))
        step = 0
        while playing.any():
            drawn = random_below(spec.n, seed, *words, step, 1).to(spec.device)
            explores = random_bits(seed, *words, step, 0).to(spec.device) < round(epsilon * 2**32)
            td[keys.ACTION] = drawn if policy is None else policy(td)[keys.ACTION]
            td[keys.ACTION] = torch.where(explores, drawn, td[keys.ACTION])
            td = env.step(td)
            earned = td["next", keys.OWN_REWARD].sum((1, 2)).double().cpu()
            total += torch.where(playing, earned, 0.0)
            steps += playing
            step += 1
            playing &= ~td["next", keys.DONE].flatten().cpu()
            td = env.maybe_reset(step_mdp(td))
    rows = zip(seeds.tolist(), steps.tolist(), total.tolist(), strict=True)
    return [dict(zip(("seed", "steps", "return"), row, strict=True)) for row in rows]
