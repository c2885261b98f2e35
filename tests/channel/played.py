"""Schemes over channels, played for some steps in the network that learners run."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from marl_clean import keys
from marl_clean.channel.base import Channel
from marl_clean.comm.base import Comm, Talk
from marl_clean.config.class_source import takes
from marl_clean.config.levels import rooms
from marl_clean.config.schema import instantiate
from marl_clean.encoder.base import Encoder
from marl_clean.learning.networks import RobotsNetwork
from tests.comm.contract import FEATURES, draw

CONF = Path(__file__).parents[2] / "conf" / "channel"
LEVELS = rooms()["channel"]
Stack = dict[str, dict[str, Any]]  # levels and what is changed of their yaml
NEUTRAL: Stack = {
    "perfect": {},
    "lossy": {"loss": 0.0},
    "delayed": {},  # where nothing changes, what was said earlier is what is said
    "quantised": {"bits": 16, "limit": 16.0},
    "noisy": {"std": 1e-6},
    "budget": {"messages": 99},
}
"""Settings that leave alone what crosses; a level that is not named here has none."""


class Same(Encoder):
    """A robot sees its features."""

    def __init__(self, memory: str = "none") -> None:
        super().__init__()
        self.out_features = FEATURES
        self.remember(memory)

    def forward(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch agent feature"]:
        return observation


class Frames(NamedTuple):
    """Steps in a row: features, who may talk to whom, who is how near, draws, who is where."""

    feature: Tensor
    live: Tensor
    rank: Tensor
    seed: Tensor
    offset: Tensor


def make_channel(level: str, dims: Sequence[int], **changes: Any) -> Channel:
    section = OmegaConf.merge(OmegaConf.load(CONF / f"{level}.yaml"), changes)
    asked = takes(section["_target_"], "message_dims")
    return instantiate(section, **({"message_dims": tuple(dims)} if asked else {}))


def network(comm: Comm, channels: Stack | dict[str, Channel]) -> RobotsNetwork:
    """A channel already made is taken as it is."""
    stack = {
        level: each if isinstance(each, Channel) else make_channel(level, comm.message_dims, **each)
        for level, each in channels.items()
    }
    return RobotsNetwork(Same(), comm, 1, "float32", stack).double().eval()


def frames(steps: int, *batch: int, n_agents: int, share: float = 0.5, seed: int = 0) -> Frames:
    """A graph and features that change from step to step."""
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randint(2**32, (steps, *batch, n_agents), generator=generator)
    feature, live, senders = draw(steps, *batch, n_agents=n_agents, share=share, seed=seed)
    return Frames(feature, live, senders.distance_rank, drawn, senders.offset)


def play(net: RobotsNetwork, inputs: Frames) -> list[Talk]:
    """What is said and made of it in each step, nothing carried into the first."""
    batch, n_agents = inputs.seed.shape[1:-1], inputs.seed.shape[-1]
    specs = net.state_specs(n_agents)
    carried = {key: specs[key].zero(batch) for key in net.carries}
    carried = {key: c.double() if c.is_floating_point() else c for key, c in carried.items()}
    talks = []
    for feature, live, rank, seed, offset in zip(*inputs, strict=True):
        seen = {keys.ADJACENCY: live, keys.DISTANCE_RANK: rank, keys.CHANNEL_SEED: seed}
        seen[keys.OFFSET] = offset
        seen[keys.TARGET] = feature[..., :3]  # of its own robot alone, as what is sent has to be
        _, talk, carried = net.decide(feature, seen | carried)
        talks.append(talk)
    return talks


def features(talks: list[Talk]) -> Tensor:
    return torch.stack([talk.feature for talk in talks])


def relabelled(inputs: Frames, order: Tensor) -> Frames:
    feature, live, rank, seed, offset = inputs
    return Frames(
        feature[..., order, :],
        live[..., order, :][..., order],
        rank[..., order, :][..., order],
        seed[..., order],
        offset[..., order, :, :][..., order, :],
    )
