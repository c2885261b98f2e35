"""The tensor world against the plain one: `python -m tests.reliability.simulator --steps 1000000`.

Random houses, robots, readings of the rules and plays are drawn until so many steps were compared,
every number of each. Mutants of the tensor world, one small fault each, must all be seen.
"""

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from types import ModuleType
from typing import Any
from unittest import mock

import torch
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from jaxtyping import config

from marl_clean.env import cleaning
from marl_clean.topology import base as topology
from marl_clean.topology import radius
from marl_clean.world import dynamics, episode, rewards, shared_map, step
from tests.reference import World
from tests.world.strategies import MOST_AGENTS, Case, cases
from tests.world.test_against_reference import (
    assert_same_play,
    exchanging,
    hearing_patches,
    lending,
)

BATCH = 100  # plays that are drawn from one seed
DRAWN = st.one_of(
    cases(max_agents=MOST_AGENTS),
    cases(max_agents=MOST_AGENTS),
    *(cases(settings=telling) for telling in (exchanging, lending, hearing_patches)),
)
Mutant = tuple[ModuleType, str, Callable[..., Any]]


def _ends_late(state: Any, stuck_after: int | None) -> Any:
    truncated = state.step > state.max_steps
    terminated = state.num_visited >= state.num_free
    return terminated, truncated & ~terminated


def _first_map(record: torch.Tensor) -> torch.Tensor:
    return record[:, 0]


def _later_of_all(record: torch.Tensor, contact: torch.Tensor) -> torch.Tensor:
    return _merge(record, torch.ones_like(contact))


def _younger(record: torch.Tensor, now: torch.Tensor, rules: Any) -> torch.Tensor:
    return _map_value(record, now - 1, rules)


def _nearly(position: torch.Tensor, radius_cells: float) -> torch.Tensor:
    return _in_radius(position, radius_cells - 1)


def _any_wall(held: Any, moved: Any, bumped: Any, rules: Any) -> Any:
    return moved & (held <= 0), bumped


def _in_order(position: torch.Tensor) -> torch.Tensor:
    envs, robots = position.shape[:2]
    return torch.arange(robots).expand(envs, robots, robots)


_merge, _map_value, _in_radius = step.merge_maps, shared_map.map_value, radius.in_radius
MUTANTS: dict[str, Mutant] = {
    "an action costs nothing": (rewards, "step_term", lambda moved: torch.zeros(moved.shape)),
    "every wall is a discovery": (rewards, "learnt", _any_wall),
    "what is dirty does not count": (
        *(rewards, "is_known_dirty"),
        lambda held, now, rules: torch.zeros_like(held, dtype=torch.bool),
    ),
    "a spill pays nothing": (
        *(dynamics, "spill_term"),
        lambda spilt, rules: torch.zeros(spilt.shape),
    ),
    "a collision pays nothing": (
        *(dynamics, "collision_term"),
        lambda collided, rules: torch.zeros(collided.shape),
    ),
    "a team is paid by its first map": (dynamics, "union_of_maps", _first_map),
    "maps age a step less": (shared_map, "map_value", _younger),
    "maps of all are merged": (step, "merge_maps", _later_of_all),
    "nothing is touched": (step, "touch_", lambda state, rules: None),
    "an episode ends a step late": (step, "episode_ends", _ends_late),
    "starts are dirty": (episode, "_clean_starts_", lambda state, rules: None),
    "nothing is spilt": (cleaning, "spill_", lambda state, setup: None),
    "robots are ranked by number": (topology, "distance_rank", _in_order),
    "a radius is a cell shorter": (radius, "in_radius", _nearly),
}


def compare(steps: int, first_seed: int = 0, mutant: Mutant | None = None) -> int:
    """Compare at least so many steps; return how many.

    Raises AssertionError, or what the tensor world raises, where the two differ.
    """
    compared, batch = 0, first_seed
    step_of = World.step

    def counting(world: World, actions: Any) -> Any:
        nonlocal compared
        compared += 1
        return step_of(world, actions)

    planted: AbstractContextManager = nullcontext()
    if mutant is not None:
        planted = mock.patch.object(*mutant[:2], mutant[2])
    with planted, mock.patch.object(World, "step", counting):
        while compared < steps:
            _play(batch)
            batch += 1
    return compared


def _play(batch: int) -> None:
    """Play a batch of cases; a fault is not made smaller, which would take as long."""

    @seed(batch)
    @settings(
        max_examples=BATCH,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=DRAWN, whole_map=st.booleans())
    def play(case: Case, whole_map: bool) -> None:
        assert_same_play([case], whole_map)

    play()


def is_caught(mutant: Mutant, steps: int) -> bool:
    """Whether a mutant is seen within so many steps."""
    try:
        compare(steps, mutant=mutant)
    except AssertionError:
        return True
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=18_000)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config.update("jaxtyping_disable", True)
    began = time.monotonic()
    compared = compare(arguments.steps)
    caught = sum(is_caught(mutant, 18_000) for mutant in MUTANTS.values())
    sys.stdout.write(
        f"{compared:,} steps: 0 differences; {caught} of {len(MUTANTS)} mutants seen;"
        f" {time.monotonic() - began:.0f} s\n"
    )


if __name__ == "__main__":
    main()
