"""A share of a training's worlds, and the learner that acts in them, for one process."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from omegaconf import DictConfig
from torchrl.envs import EnvBase

from marl_clean import build
from marl_clean.config.locate import named_plugins, use_plugins
from marl_clean.learning.agent import Agent

MakeShare = Callable[[int, int], "Share"]
"""Makes share `index` of so many, in the process that will collect; it can be pickled."""
STREAMS = 2**32  # seeds of configs are smaller, so no two processes of two runs draw alike


@dataclass(frozen=True)
class Share:
    """Worlds, and a learner of the trainer's kind that acts in them with the trainer's weights."""

    env: EnvBase
    agent: Agent


def share_maker(cfg: DictConfig) -> MakeShare:
    """Return what makes the shares of the worlds of `cfg`, on the CPU, wherever the trainer is."""
    return partial(_make_share, cfg, os.getcwd(), named_plugins())


def _make_share(
    cfg: DictConfig, folder: str, plugins: Sequence[str], index: int, num: int
) -> Share:
    """World i of a share of b worlds is world `index * b + i` of the training.

    What policies draw comes from a stream of the process's own, which the config's seed and `index`
    decide.
    """
    os.chdir(folder)  # a worker of a cluster begins elsewhere, and paths of houses are relative
    use_plugins(plugins)
    cfg = cfg.copy()
    cfg.device = "cpu"
    worlds = cfg.env.num_envs // num
    env = build.make_env(cfg, num_envs=worlds, first_env=index * worlds)
    agent = build.make_agent(cfg, env)
    env = build.ready_for(agent, env)
    torch.manual_seed(cfg.seed + STREAMS * (index + 1))
    return Share(env, agent)
