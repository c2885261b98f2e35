"""Small networks and random frames for the tests of learners."""

from collections.abc import Sequence

import torch
from omegaconf import OmegaConf
from tensordict import TensorDict
from torch import Tensor

from marl_clean import build, keys
from marl_clean.agent.iql import Iql
from marl_clean.comm.base import Comm
from marl_clean.config import levels
from marl_clean.config.class_source import constant
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.encoder.cnn import Cnn
from marl_clean.learning.agent import Agent
from marl_clean.learning.networks import Entries
from marl_clean.observation.crop import Crop

CODES = torch.tensor([-1.0, -0.2, 0.0, 0.3, 0.5, 1.0])
SIDE = 9
STATE_SHAPE = (1, 1, 2)
SMALL = {
    "plan": {"hidden": 24, "received": 16},
    "zeroed": {"hidden": 24, "received": 16},
    "full_state": {"hidden": 24, "received": 24},
    "commnet": {"hidden": 24},
    "dgn": {"hidden": 24, "heads": 2, "head_dim": 8},
    "magic": {"signal_dim": 8, "message_dim": 16, "heads": 2, "head_dim": 8, "hidden": 24},
    "dcc": {"message_dim": 16, "heads": 2, "head_dim": 8},
    "expocomm": {"hidden": 24},
    "masia": {"message_dim": 16, "key_dim": 8, "hidden": 24},
}

IQL = {
    "double": True,
    "dueling": True,
    "n_steps": 3,
    "gamma": 0.9,
    "lr": 1e-3,
    "lr_end": 1e-3,
    "loss": "smooth_l1",
    "max_grad_norm": 10.0,
    "target_update": "soft",
    "tau": 0.1,
    "target_period": 3,
    "eps_init": 1.0,
    "eps_end": 0.05,
    "annealing_fraction": 0.5,
    "precision": "float32",
    "augment": False,
}


def make_encoder(side: int = SIDE, **changes) -> Cnn:
    settings = {
        "channels": [6, 8],
        "kernel_size": 3,
        "strides": [2, 2],
        "padding": 1,
        "hidden": [24],
        "dropout": 0.0,
        "planes": True,
        "channels_last": True,
        "spread": Crop.spread,
    }
    torch.manual_seed(0)
    return Cnn(torch.Size([1, side, side]), **(settings | changes))


def make_comm(level: str, encoder: Cnn, side: int = SIDE) -> Comm:
    torch.manual_seed(1)
    section = OmegaConf.create({**levels.read_level("comm", level), **SMALL.get(level, {})})
    return build.make_comm(section, encoder.out_features, torch.Size([1, side, side]))


def make_agent(comm: str = "plan", side: int = SIDE, encoder: Cnn | None = None, **changes) -> Iql:
    encoder = encoder or make_encoder(side)
    torch.manual_seed(2)
    return Iql(encoder, make_comm(comm, encoder, side), **(IQL | changes))


LEARNERS = levels.rooms()["agent"]


def make_learner(level: str, comm: str, **changes) -> Agent:
    """A learner by its yaml, with a small network for two robots."""
    encoder = make_encoder()
    section = OmegaConf.create(levels.read_level("agent", level))
    section = OmegaConf.create({**section, "precision": "float32"})
    parts = {"encoder": encoder, "comm": make_comm(comm, encoder), "channels": {}}
    parts |= {"n_agents": 2, "num_actions": 4}
    if constant(section["_target_"], "needs_state") or changes.get("critic") == "state":
        parts["state_shape"] = torch.Size(STATE_SHAPE)
    torch.manual_seed(2)
    return instantiate(section, **{**parts, **changes})


def frames(count: int, n_agents: int = 2, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Observations, adjacency and distance ranks."""
    draw = torch.Generator().manual_seed(seed)
    observation = CODES[torch.randint(6, (count, n_agents, 1, SIDE, SIDE), generator=draw)]
    live = (torch.rand(count, n_agents, n_agents, generator=draw) < 0.5).triu(1)
    rank = (torch.arange(n_agents)[None] - torch.arange(n_agents)[:, None]) % n_agents
    return observation, live | live.mT, rank.expand(count, -1, -1).contiguous()


def by_key(seen: Sequence[Tensor]) -> Entries:
    """What `frames` returns, as a network takes it."""
    return dict(zip((keys.OBSERVATION, keys.ADJACENCY, keys.DISTANCE_RANK), seen, strict=True))


def transitions(count: int, n_agents: int = 2, seed: int = 0) -> TensorDict:
    """A batch of frames as the replay gives it: every ending, n-step windows of 1 to 3."""
    draw = torch.Generator().manual_seed(seed)
    terminated = torch.rand(count, 1, generator=draw) < 0.3
    done = terminated | (torch.rand(count, 1, generator=draw) < 0.3)
    now, then = frames(count, n_agents, seed), frames(count, n_agents, seed + 1)
    seen = ("observation", "adjacency", "distance_rank")
    action = torch.randint(4, (count, n_agents), generator=draw)
    reward = torch.randn(count, n_agents, 1, generator=draw)
    agents = dict(zip(seen, now, strict=True)) | {"action": action}
    later = dict(zip(seen, then, strict=True)) | {"reward": reward}
    shape = [count, n_agents]
    return TensorDict(
        {
            keys.AGENTS: TensorDict(agents, shape),
            "next": TensorDict(
                {keys.AGENTS: TensorDict(later, shape), "done": done, "terminated": terminated},
                [count],
            ),
            keys.STEPS_TO_NEXT_OBS: torch.randint(1, 4, (count,), generator=draw),
        },
        [count],
    )


def collected(settings: Sequence[str], steps: int = 12) -> tuple[Agent, TensorDict]:
    """Return a learner of these settings, and a block that it collected `[env, time]`."""
    config = compose_config(settings)
    torch.manual_seed(0)
    env = build.make_env(config)
    agent = build.make_agent(config, env)
    env = build.ready_for(agent, env)
    with torch.no_grad():
        policy = agent.exploration(env.full_action_spec)
        block = env.rollout(steps, policy, break_when_any_done=False).contiguous()
    return agent, block
