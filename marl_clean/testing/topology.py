"""What every topology must hold."""

from typing import Any

import torch
from torch import Tensor

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.testing._broken import Clause, require, require_equal, verify
from marl_clean.testing._levels import Level, Maker, maker
from marl_clean.testing._worlds import N_AGENTS, drawn_actions, make_worlds
from marl_clean.topology.base import Topology
from marl_clean.world.state import State

MEMORIES = ("shared", "private", "merged")
STEPS = 12


def check_topology(level: Level, **settings: Any) -> None:
    """A topology says which robots are in contact: symmetric, never with itself.

        >>> check_topology("radius", radius_cells=2.0)

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    made = maker("topology", level, settings)
    verify(made.label, CLAUSES, made)


def require_graph(adjacency: Tensor, where: str) -> None:
    """Raise ContractBroken unless contact is bool, mutual and never with itself."""
    require(adjacency.dtype == torch.bool, f"{where}: contact is {adjacency.dtype}, not bool")
    one_way = (adjacency & ~adjacency.mT).nonzero()
    require(len(one_way) == 0, f"{where}: contact is not mutual at {one_way[:1].tolist()}")
    itself = adjacency.diagonal(dim1=-2, dim2=-1).nonzero()
    require(len(itself) == 0, f"{where}: in contact with itself at {itself[:1].tolist()}")


def contact_is_mutual_and_in_the_spec(make: Maker) -> None:
    """Contact is `[env, agent, agent]` bool, mutual, never with itself, and within the spec."""
    for memory in MEMORIES:
        env = make_worlds([make()], settings=(f"env.memory={memory}",))
        seen = env.rollout(STEPS, break_when_any_done=False)
        shape = (6, STEPS, N_AGENTS, N_AGENTS)
        for part in (seen, seen["next"]):
            adjacency = part[keys.ADJACENCY]
            require(adjacency.shape == shape, f"adjacency is {list(adjacency.shape)}, not {shape}")
            require_graph(adjacency, f"env.memory={memory}")
            for key in (keys.ADJACENCY, keys.DISTANCE_RANK):
                inside = all(env.observation_spec[key].is_in(part[key][:, t]) for t in range(STEPS))
                require(inside, f"{key} leaves its spec with env.memory={memory}")


def reading_contact_changes_nothing(make: Maker) -> None:
    """Reading contact leaves the worlds unchanged, and is repeatable."""
    topology, state, env = _started(make)
    before = {name: value.clone() for name, value in state.tensors().items()}
    first = topology.contact(state, env.rules)
    for name, value in state.tensors().items():
        require_equal(value, before[name], f"contact changes the worlds' {name}")
    require_equal(topology.contact(state, env.rules), first, "contact differs when read twice")


def relabelling_the_robots_relabels_contact(make: Maker) -> None:
    """Contact does not depend on how robots are numbered."""
    topology, state, env = _started(make)
    order = torch.tensor([2, 0, 1])
    of_robots = {"position", "record", "moved", "bumped", "collided", "newly_cleaned"}
    renamed = State(**{k: v[:, order] if k in of_robots else v for k, v in state.tensors().items()})
    permuted = topology.contact(state, env.rules)[:, order][..., order]
    contact = topology.contact(renamed, env.rules)
    require_equal(permuted, contact, f"robots renumbered as {order.tolist()} have other contacts")


def a_batch_equals_each_world_alone(make: Maker) -> None:
    """A world's contact is what it is alone, across resets too."""
    settings = ("env.stuck_after=4",)
    actions = drawn_actions(STEPS, 4)

    def contacts(chosen: Tensor, **place: Any) -> Tensor:
        env = make_worlds([make()], settings=settings, **place)
        td, seen = env.reset(), []
        for action in chosen:
            td[keys.ACTION] = action
            _, td = env.step_and_maybe_reset(td)
            seen.append(td[keys.ADJACENCY].clone())
        return torch.stack(seen)

    together = contacts(actions, num_envs=4)
    for world in range(4):
        alone = contacts(actions[:, world : world + 1], num_envs=1, first_env=world)
        broken = f"world {world} of 4 has other contacts alone"
        require_equal(together[:, world], alone[:, 0], broken)


def without_positions_it_is_a_graph_or_refused(make: Maker) -> None:
    """Where an env has no positions, contact is a fixed graph or BadInput."""
    for n_agents in (1, 2, 5):
        try:
            graph = make().among(n_agents)
        except BadInput:
            continue
        shape = (n_agents, n_agents)
        require(graph.shape == shape, f"among({n_agents}) is {list(graph.shape)}, not {shape}")
        require_graph(graph, f"among({n_agents})")


def _started(make: Maker) -> tuple[Topology, State, CleaningEnv]:
    """A topology, and worlds with private maps some steps into an episode."""
    topology = make()
    env = make_worlds([topology], settings=("env.memory=private",))
    env.rollout(STEPS, break_when_any_done=False)
    return topology, env.base_env.state, env.base_env


CLAUSES: tuple[Clause, ...] = (
    contact_is_mutual_and_in_the_spec,
    reading_contact_changes_nothing,
    relabelling_the_robots_relabels_contact,
    a_batch_equals_each_world_alone,
    without_positions_it_is_a_graph_or_refused,
)
