"""Every measure of an episode, counted while a batch of environments plays (world.md "Measures").

One environment is one house and one episode. All counts are integers; what is a share becomes
one at the very end. A measure stops at the step at which the house is clean, or at the end of
the episode; only T_certify may go on.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int
from tensordict import TensorDictBase
from torch import Tensor

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.evaluation import bounds
from marl_clean.evaluation.optimum import MOST_CELLS, optimal_T_100
from marl_clean.keys import ADJACENCY, DONE, MESSAGE_BITS, MESSAGE_EDGES, OWN_REWARD
from marl_clean.settings import Knowledge, Sensor
from marl_clean.world.distance import neighbours
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import is_unknown
from marl_clean.world.state import State, cell_index

PERCENTS = (90, 95, 99, 100)
NEVER = -1
Record = dict[str, int | float | str | None]


class Recorder:
    """Follows episodes from their reset to their end, whatever the environments do after.

    `Recorder(env)` after the reset, `update(td)` with the tensordict of each step (root and
    "next"), `records()` once nothing is `playing`. With `certify` a clean house plays on until
    no unknown cell is beside one that a robot has stood on. With `optimum` the times are held
    against the proven least T_100 too.
    """

    def __init__(self, env: CleaningEnv, certify: bool = False, optimum: bool = False) -> None:
        self.env = env
        self.certify = certify
        state = env.state
        num_envs, n_agents, _ = state.position.shape
        device = state.step.device
        self.bounds = episode_bounds(state, env.rules)
        self.optima = episode_optima(state, env.rules) if optimum else None
        self.rows, self.cols = state.rows.clone(), state.cols.clone()
        self.max_steps, self.num_free = state.max_steps.clone(), state.num_free.clone()

        def zeros(*shape: int, dtype: torch.dtype = torch.int64) -> Tensor:
            return torch.zeros((num_envs, *shape), dtype=dtype, device=device)

        cells = state.blocked[0].numel()
        self.entered = zeros(n_agents, cells, dtype=torch.bool)  # by each robot
        self._enter(state, torch.ones_like(state.moved))
        self.num_entries = zeros() + n_agents
        self.first_cleaned = zeros(n_agents) + 1  # robots never share a cell: each cleaned its own
        self.num_visited = state.num_visited.clone()
        self.sum_visited = state.num_visited.clone()  # over the steps so far
        self.steps = zeros()
        self.counts = {name: zeros() for name in COUNTED}
        self.total_reward = zeros(dtype=torch.float64)
        self.reached = {percent: zeros() + NEVER for percent in PERCENTS}
        self.certified_at = zeros() + NEVER
        self.measuring = zeros(dtype=torch.bool) | True
        self.playing = self.measuring.clone()
        self._note(state)

    def update(self, step: TensorDictBase) -> None:
        """Count one step: `step` holds what was seen and done, and under "next" what came of it."""
        state, live = self.env.state, self.measuring
        each = live[:, None]
        self._enter(state, each)
        self.num_entries += (state.moved & each).sum(1)
        self.first_cleaned += state.newly_cleaned & each
        for name, count in step_counts(state, step).items():
            self.counts[name] += torch.where(live, count, 0)
        own_reward = step["next"][OWN_REWARD].to(torch.float64).sum((1, 2))
        self.total_reward += torch.where(live, own_reward, 0.0)
        self.num_visited = torch.where(live, state.num_visited, self.num_visited)
        self.sum_visited += torch.where(live, state.num_visited, 0)
        self.steps = torch.where(live, state.step, self.steps)
        self._note(state)
        self._stop(state, step["next"][DONE].flatten())

    def share_done(self) -> float:
        """How much of the episodes is over: of each its coverage or its steps, what is more."""
        by_cells = self.num_visited / self.num_free
        by_steps = self.steps / self.max_steps
        share = torch.maximum(by_cells, by_steps).clamp(max=1)
        return float(torch.where(self.playing, share, 1.0).mean())

    def _enter(self, state: State, counts: Bool[Tensor, "env agent_or_1"]) -> None:
        """Mark the cell under each robot as entered by it, where the house still counts."""
        cell = cell_index(state.position, self.env.rules.margin, state.blocked.shape[2])[..., None]
        before = self.entered.gather(2, cell)
        self.entered.scatter_(2, cell, before | counts[..., None])

    def _note(self, state: State) -> None:
        """Write down the times that this step is the first to reach."""
        for percent, time in self.reached.items():
            enough = self.num_visited >= bounds.need(percent, self.num_free)
            first = enough & (time == NEVER)
            self.reached[percent] = torch.where(first, state.step, time)
        if self.certify:
            unsure = self.playing & (self.certified_at == NEVER)
            sure = unsure & certified(state, self.entered)
            self.certified_at = torch.where(sure, state.step, self.certified_at)

    def _stop(self, state: State, done: Bool[Tensor, " env"]) -> None:
        """Being done ends the measures, and also the play unless a clean house waits to be sure."""
        self.measuring = self.measuring & ~done
        clean = self.num_visited >= self.num_free
        unsure = (self.certified_at == NEVER) & (state.step < self.max_steps)
        self.playing = self.playing & (self.measuring | (self.certify & clean & unsure))

    def records(self) -> list[Record]:
        """One record a house, in the order of the environments; the names are world.md's."""
        columns: dict[str, list[Any]] = {
            "rows": self.rows.tolist(),
            "cols": self.cols.tolist(),
            "free_cells": self.num_free.tolist(),
            **self.bounds,
            "max_steps": self.max_steps.tolist(),
            **self._times(),
            **{name: values.tolist() for name, values in self._shares().items()},
            "bumps": self.counts["bumps"].tolist(),
            "collisions": self.counts["collisions"].tolist(),
        }
        for name in RATES:
            columns[name] = shares(self.counts[name], self.steps)
        for name in COSTS:
            columns[f"{name}_per_cell"] = shares(self.counts[name], self.num_visited)
        columns["gate"] = shares(self.counts["spoken"], self.counts["speakable"])
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def _times(self) -> dict[str, list[int | float | None]]:
        """T_q and T_certify, null where not reached, and each as a multiple of its bound."""
        times = {str(percent): time for percent, time in self.reached.items()}
        if self.certify:
            times["certify"] = self.certified_at
        found: dict[str, list[int | float | None]] = {
            f"T_{name}": [None if step == NEVER else step for step in time.tolist()]
            for name, time in times.items()
        }
        for name in times:
            pairs = zip(found[f"T_{name}"], self.bounds[f"bound_{name}"], strict=True)
            found[f"ratio_{name}"] = [ratio(time, bound) for time, bound in pairs]
        if self.optima is not None:
            found["optimum_100"] = list(self.optima)
            pairs = zip(found["T_100"], self.optima, strict=True)
            found["gap_100"] = [ratio(time, least) for time, least in pairs]
        return found

    def _shares(self) -> dict[str, Tensor]:
        """The measures that are quotients of counts, as float64 [B]."""
        own = self.entered.sum(2)  # distinct cells of each robot
        distinct = self.entered.any(1).sum(1)
        cleaned = self.first_cleaned.to(torch.float64)
        # What the last step left stays until max_steps: 1 in a clean house.
        remaining = (self.max_steps - self.steps) * self.num_visited
        return {
            "coverage": self.num_visited / self.num_free.to(torch.float64),
            "coverage_auc": (self.sum_visited + remaining)
            / (self.num_free * (self.max_steps + 1)).to(torch.float64),
            "return": self.total_reward,
            "redundancy": (self.num_entries - distinct) / distinct.to(torch.float64),
            "overlap": (own.sum(1) - distinct) / distinct.to(torch.float64),
            "balance": cleaned.std(1, correction=0) / cleaned.mean(1),
        }


COSTS = ("messages", "edges", "bits", "rounds")  # told per step, and per cell cleaned
RATES = ("contact", *COSTS)  # counted, and told per step
COUNTED = ("bumps", "collisions", *RATES, "spoken", "speakable")


def step_counts(state: State, step: TensorDictBase) -> dict[str, Int[Tensor, " env"]]:
    """What is counted each step: bumps, collisions, and what went between the robots.

    An edge is a pair in contact when the actions were chosen; a message is what one robot sends
    along one of its edges in one round, so a step has two messages an edge and round, fewer where
    a robot chooses or has to be silent, and none under a silent policy. A round counts where
    anybody sent. The gate's rate is the share of robots in contact that were written to in the
    first round, of a policy that sends at all.
    """
    adjacency = step[ADJACENCY]
    degree = adjacency.sum(2)
    bits = step.get(MESSAGE_BITS, None)  # only policies that communicate write these
    reached = step.get(MESSAGE_EDGES, None)
    cost = torch.zeros_like(degree) if bits is None else bits[..., 0].round().to(torch.int64)
    if reached is None:  # one round to all in contact, where it costs anything
        reached = torch.where(cost > 0, degree, 0).unsqueeze(-1)
    reached = reached.round().to(torch.int64).sum(1)  # over the senders
    sends = bits is not None and reached.shape[-1] > 0
    return {
        "bumps": state.bumped.sum(1),
        "collisions": state.collided.sum(1),
        "contact": adjacency.flatten(1).any(1).to(torch.int64),
        "messages": reached.sum(1),
        "edges": degree.sum(1) // 2,
        "bits": cost.sum(1),
        "rounds": (reached > 0).sum(1),
        "spoken": reached[:, 0] if sends else torch.zeros_like(degree[:, 0]),
        "speakable": degree.sum(1) if sends else torch.zeros_like(degree[:, 0]),
    }


def shares(counts: Int[Tensor, " env"], of: Int[Tensor, " env"]) -> list[float | None]:
    """Each count as a share of another; null where that is 0."""
    return [a / b if b else None for a, b in zip(counts.tolist(), of.tolist(), strict=True)]


def certified(state: State, entered: Bool[Tensor, "env agent cell"]) -> Bool[Tensor, " env"]:
    """Tell where no unknown cell is a 4-neighbour of a cell some robot has stood on."""
    unknown = is_unknown(state.record).all(1)  # to every robot
    stood = entered.any(1).view_as(unknown)
    beside = neighbours(stood, False).any(0)
    return ~(beside & unknown).flatten(1).any(1)


def ratio(time: int | float | None, bound: int | None) -> float | None:
    """A time as a multiple of its bound; null without a time, or where the bound is 0 or null."""
    return time / bound if time is not None and bound else None


def episode_bounds(state: State, rules: Rules) -> dict[str, list[int | None]]:
    """The bounds on each T, for worlds at step 0; null where furniture moves.

    That on T_certify holds for blind robots only: `sensor=bump` and `knowledge=unknown`.
    """
    names = [f"bound_{percent}" for percent in PERCENTS] + ["bound_certify"]
    found: dict[str, list[int | None]] = {name: [None] * len(state.step) for name in names}
    if state.furniture_moves.shape[1] > 0:
        return found
    free, starts = plans_of(state, rules)
    num_free, num_starts = free.sum(axis=(1, 2)), bounds.count_starts(starts)
    for percent in PERCENTS:
        least = bounds.bound_percent(percent, num_free, num_starts, starts.shape[1])
        found[f"bound_{percent}"] = least.tolist()
    found["bound_100"] = bounds.bound_100(free, starts).tolist()
    if rules.sensor is Sensor.BUMP and rules.knowledge is Knowledge.UNKNOWN:
        found["bound_certify"] = bounds.bound_certify(free, starts).tolist()
    return found


def episode_optima(state: State, rules: Rules) -> list[int | None]:
    """The proven least T_100, for worlds at step 0; null where furniture moves or F is large."""
    if state.furniture_moves.shape[1] > 0:
        return [None] * len(state.step)
    return [
        optimal_T_100(free, starts) if free.sum() <= MOST_CELLS else None
        for free, starts in zip(*plans_of(state, rules), strict=True)
    ]


def plans_of(
    state: State, rules: Rules
) -> tuple[Bool[np.ndarray, "env row col"], Int[np.ndarray, "env agent 2"]]:
    """The free cells and the robots' places, on the host."""
    inner = slice(rules.margin, -rules.margin)
    return (~state.blocked[:, inner, inner]).cpu().numpy(), state.position.cpu().numpy()
