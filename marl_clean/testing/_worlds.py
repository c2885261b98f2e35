"""Small worlds for the contracts, with no level of any room except the one under test."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, final

import numpy as np
import torch
from jaxtyping import Bool
from omegaconf import DictConfig
from torch import Tensor
from torchrl.envs import Compose, Transform, TransformedEnv

from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.env.transformed import TransformedWorlds
from marl_clean.house.base import House, HouseLayout, Houses, draw_houses, keep_region
from marl_clean.settings import HouseOrder
from marl_clean.topology.base import Topology
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import in_radius
from marl_clean.world.state import State

N_AGENTS = 3


@final
@dataclass(frozen=True)
class Scattered(House):
    """Blocked cells at random places; the largest free region is kept."""

    generated: ClassVar[bool] = True

    rows: tuple[int, int] = (5, 9)
    cols: tuple[int, int] = (5, 9)
    blocked: float = 0.2

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        numbers = np.random.default_rng([seed, draw])
        shape = tuple(numbers.integers(*sides, endpoint=True) for sides in (self.rows, self.cols))
        free = numbers.random(shape) >= self.blocked
        return keep_region(HouseLayout(free, np.zeros(shape, np.int16), None, seed))


@final
class Near(Topology):
    """Robots talk within three cells."""

    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        return in_radius(state.position, 3.0)


@cache
def scattered_houses(count: int = 6) -> Houses:
    """Return small houses of several sizes."""
    return draw_houses(Scattered(), range(count), N_AGENTS)


@cache
def lane() -> Houses:
    """Return one house of a single row."""
    return draw_houses(Scattered((1, 1), (7, 7), 0.0), [0], N_AGENTS)


@cache
def config(*settings: str) -> DictConfig:
    """Return a composed config; composing takes longer than most clauses."""
    return compose_config(settings)


def make_worlds(
    transforms: Sequence[Transform] = (),
    houses: Houses | None = None,
    *,
    settings: Sequence[str] = (),
    num_envs: int = 6,
    first_env: int = 0,
    reach_cells: int = 1,
    torchrl: bool = False,
    **changes: Any,
) -> TransformedEnv:
    """Return worlds under transforms, with the topology `Near` where they contain none.

    World i has house i. With `torchrl` a step is made by TorchRL's own method.
    """
    topologies = [t for t in transforms if isinstance(t, Topology)]
    topology = topologies[0] if topologies else Near()
    env = instantiate(
        config(*settings).env,
        houses=scattered_houses() if houses is None else houses,
        margin=max(1, reach_cells),
        house_order=HouseOrder.FIXED,
        contact=topology.contact,
        first_env=first_env,
        seed=0,
        device=torch.device("cpu"),
        num_envs=num_envs,
        **{"n_agents": N_AGENTS, **changes},
    )
    stack = list(transforms) if topologies else [topology, *transforms]
    return (TransformedEnv if torchrl else TransformedWorlds)(env, Compose(*stack))


def drawn_actions(steps: int, num_envs: int, n_agents: int = N_AGENTS) -> Tensor:
    """Return random actions, `[step, env, agent]`."""
    generator = torch.Generator().manual_seed(7)
    return torch.randint(4, (steps, num_envs, n_agents), generator=generator)
