"""What planners share: they read the robots' map, never the house."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.world.distance import UNREACHABLE, walking_distance
from marl_clean.world.dynamics import moves_on
from marl_clean.world.random import Purpose, random_below
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import (
    is_known_blocked,
    is_known_dirty,
    is_known_spilt,
    is_known_uncleaned,
    is_unknown,
)
from marl_clean.world.state import State

Grid = Bool[Tensor, "env map height width"]
Distance = Int[Tensor, "env map height width"]
Tier = tuple[Grid, Grid]  # (passable, targets) of one search; tiers are searched in order


TRACKED = ("episode", "position", "heading")  # of a `Track`


class Known(NamedTuple):
    """What the robots know of the house and its ring, all maps without their margin."""

    cell: Int[Tensor, "env agent"]  # where each robot stands, flat
    blocked: Grid
    passable: Grid  # neither known to be blocked nor occupied now
    unknown: Grid
    unvisited: Grid  # unknown, or known to be available but not cleaned in this episode
    dirty: Grid
    spilt: Grid  # dirty because of a spill


class Planner(TensorDictModuleBase):
    """A policy for the `CleaningEnv` given to `bind`; writes `("agents", "action")`."""

    def __init__(self) -> None:
        super().__init__()
        self.in_keys = [keys.POSITION]
        self.out_keys = [keys.ACTION]

    @property
    @abstractmethod
    def label(self) -> str:
        """The policy's name in tables and `evaluation.json`."""

    def bind(self, env: CleaningEnv) -> "Planner":
        """Plan for the robots of `env` from now on."""
        self.__dict__["env"] = env  # not a submodule: a policy does not own its env
        self.track = Track(env.state)
        return self

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict.set(keys.ACTION, self.act())
        return tensordict

    def memory(self) -> dict[str, Tensor]:
        """Return what it remembers of the present episodes, to go on from by `restore`."""
        return {name: getattr(self.track, name).clone() for name in TRACKED}

    def restore(self, memory: Mapping[str, Tensor]) -> None:
        """Go on from a `memory` of a planner for as many robots in as many worlds."""
        for name in TRACKED:
            setattr(self.track, name, memory[name].to(self.env.device))

    @abstractmethod
    def act(self) -> Int[Tensor, "env agent"]:
        """Return an action for every robot from `self.env.state`."""

    def random_action(self) -> Int[Tensor, "env agent"]:
        """Draw actions that depend on (seed, env, episode, step, robot) alone."""
        env = self.env
        state = env.state
        robot = torch.arange(state.n_agents, device=env.device)
        words = (
            env.env_index,
            state.episode,
            torch.full_like(state.step, Purpose.ACTION),
            state.step,
        )
        return random_below(4, env.seed_in_use, *(word[:, None] for word in words), robot)


class Track:
    """Follows robots from call to call, anew in each episode; repeated calls change nothing.

    `heading` is the direction of each robot's last move, -1 before its first.
    """

    def __init__(self, state: State) -> None:
        self.episode = torch.full_like(state.episode, -1)
        self.position = state.position
        self.heading = torch.full_like(state.position[..., 0], -1)

    def follow(self, state: State) -> Bool[Tensor, " env"]:
        """Update positions and headings; return which worlds are at the start of an episode."""
        at_start = (state.step == 0) | (state.episode != self.episode)
        row, col = (state.position - self.position).unbind(-1)
        direction = torch.where(row != 0, row + 1, 2 - col)
        one_step = row.abs() + col.abs() == 1
        heading = torch.where(one_step, direction, self.heading)
        self.heading = torch.where(at_start[:, None], -1, heading)
        self.episode, self.position = state.episode, state.position
        return at_start


class Sweep(Planner):
    """Steps to the open neighbour that comes first in `order`; stuck: to the nearest open cell.

    Open cells are those not occupied now that are unknown, or known to be available and not
    cleaned in this episode by any robot. With no open cell anywhere: to the nearest dirty cell;
    without one: a random action.
    """

    @abstractmethod
    def order(self, known: Known) -> Int[Tensor, "env agent 4"]:
        """Return the rank of up, right, down and left for each robot; the lowest is first."""

    def act(self) -> Int[Tensor, "env agent"]:
        self.track.follow(self.env.state)
        known = read_maps(self.env.state, self.env.rules)
        rank = self.order(known)
        is_open = around(known.unvisited & known.passable, known.cell, False)
        onward = torch.where(is_open, rank, 4).argmin(-1)
        return torch.where(is_open.any(-1), onward, self.nearest(known))

    def nearest(self, known: Known) -> Int[Tensor, "env agent"]:
        """Return each robot's action towards its nearest open cell, else dirty cell, else any."""
        tiers = ((known.passable, known.unvisited), (known.passable, known.dirty))
        distances = nearest_distances(tiers, known.cell)
        return torch.where(
            reachable(distances)[..., 0], first_closest(distances), self.random_action()
        )


def read_maps(state: State, rules: Rules) -> Known:
    """Read the robots' maps and positions, and nothing else of the state."""
    rows, cols = state.record.shape[-2:]
    skipped = rules.margin - 1  # the house and its ring remain
    record = state.record[..., skipped : rows - skipped, skipped : cols - skipped]
    now = (state.step + 1).to(record.dtype).view(-1, 1, 1, 1)
    width = record.shape[3]
    cell = (state.position[..., 0] + 1) * width + state.position[..., 1] + 1
    occupied = torch.zeros_like(record[:, 0], dtype=torch.bool).flatten(1)
    occupied = occupied.scatter(1, cell, True).view_as(record[:, :1])
    blocked, unknown = is_known_blocked(record), is_unknown(record)
    return Known(
        cell=cell,
        blocked=blocked,
        passable=~blocked & ~occupied,
        unknown=unknown & ~occupied,
        unvisited=(unknown | is_known_uncleaned(record)) & ~occupied,
        dirty=is_known_dirty(record, now, rules) & ~occupied,
        spilt=is_known_spilt(record) & ~occupied,
    )


def nearest_distances(
    tiers: Iterable[Tier], cell: Int[Tensor, "env agent"]
) -> Int[Tensor, "env agent 4"]:
    """Return how far each robot's four neighbours are from the first tier that it reaches."""
    distances = torch.full((*cell.shape, 4), UNREACHABLE, dtype=torch.int32, device=cell.device)
    for passable, targets in tiers:
        idle = ~reachable(distances)
        if not idle.any():
            break
        to_targets = around(walking_distance(passable, targets), cell, UNREACHABLE)
        distances = torch.where(idle, to_targets, distances)
    return distances


def around(
    matrix: Tensor, cell: Int[Tensor, "env agent"], outside: bool | int
) -> Int[Tensor, "env agent 4"] | Bool[Tensor, "env agent 4"]:
    """Read each robot's up, right, down and left neighbour from its map [env, map, ...]."""
    height, width = matrix.shape[-2:]
    row, col = (cell // width)[..., None], (cell % width)[..., None]
    move = moves_on(cell.device)
    row, col = row + move[:, 0], col + move[:, 1]
    inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    index = row.clamp(0, height - 1) * width + col.clamp(0, width - 1)
    four = matrix.flatten(2).expand(-1, cell.shape[1], -1).gather(2, index)
    return torch.where(inside, four, outside)


def reachable(distances: Int[Tensor, "env agent 4"]) -> Bool[Tensor, "env agent 1"]:
    """Return which robots can reach a target."""
    return (distances < UNREACHABLE).any(-1, keepdim=True)


def first_closest(
    distances: Int[Tensor, "*robots 4"], rank: Int[Tensor, "*robots 4"] | None = None
) -> Int[Tensor, "*robots"]:
    """Return the action that leads closest; ties go to the lowest `rank` or action."""
    if rank is None:
        rank = torch.arange(4, device=distances.device)
    return (distances.long() * 8 + rank).argmin(-1)


def left_hand_rank(heading: Int[Tensor, "env agent"]) -> Int[Tensor, "env agent 4"]:
    """Return the rank of up, right, down and left in the order left, ahead, right, back."""
    action = torch.arange(4, device=heading.device)
    return (action - heading[..., None] + 1) % 4
