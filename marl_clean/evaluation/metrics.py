"""Every measure of an episode, counted while a batch of environments steps (world.md "Measures").

One environment is one house and one episode. All counts are integers; quotients are computed at
the end. A measure stops at the step at which the house is clean, or at the end of the episode;
only T_certify may continue.
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
from marl_clean.evaluation.spill_delay import SpillDelay
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
    """Records episodes from their reset to their end, whatever the environments do afterwards.

    `Recorder(env)` after the reset, `update(td)` with the tensordict of each step (root and
    "next"), `records()` once nothing is `running`. With `certify` the episode of a clean house
    continues until no unknown cell is beside a cell that a robot has stood on. With `optimum` the
    times are compared with the proven least T_100 too.
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

        def full(value: int | float, *shape: int, dtype: torch.dtype = torch.int64) -> Tensor:
            return torch.full((num_envs, *shape), value, dtype=dtype, device=device)

        cells = state.blocked[0].numel()
        self.entered = full(False, n_agents, cells, dtype=torch.bool)  # by each robot
        self._enter(state, torch.ones_like(state.moved))
        self.num_entries = full(n_agents)
        self.first_cleaned = full(1, n_agents)  # robots never share a cell: each cleaned its own
        self.num_visited = state.num_visited.clone()
        self.sum_visited = state.num_visited.clone()  # over the steps so far
        self.steps = full(0)
        self.counts = {name: full(0) for name in COUNTED}
        self.spills = None if state.spilt is None else SpillDelay(state)
        if state.exchanged_bits is not None:  # before the first step
            self.counts["bits"] += state.exchanged_bits.sum(1)
        self.total_reward = full(0.0, dtype=torch.float64)
        self.reached = {percent: full(NEVER) for percent in PERCENTS}
        self.certified_at = full(NEVER)
        self.measuring = full(True, dtype=torch.bool)
        self.running = self.measuring.clone()
        self._record_times(state)

    def update(self, step: TensorDictBase) -> None:
        """Count one step: observations and actions in `step`, their outcome under its "next"."""
        state, live = self.env.state, self.measuring
        each = live[:, None]
        self._enter(state, each)
        self.num_entries += (state.moved & each).sum(1)
        self.first_cleaned += state.newly_cleaned & each
        for name, count in step_counts(state, step).items():
            self.counts[name] += torch.where(live, count, 0)
        if self.spills is not None:
            self.spills.update(state, live)
        own_reward = step["next"][OWN_REWARD].to(torch.float64).sum((1, 2))
        self.total_reward += torch.where(live, own_reward, 0.0)
        self.num_visited = torch.where(live, state.num_visited, self.num_visited)
        self.sum_visited += torch.where(live, state.num_visited, 0)
        self.steps = torch.where(live, state.step, self.steps)
        self._record_times(state)
        self._stop(state, step["next"][DONE].flatten())

    def share_done(self) -> float:
        """The mean progress of the episodes: of each its coverage or its steps, if larger."""
        by_cells = self.num_visited / self.num_free
        by_steps = self.steps / self.max_steps
        share = torch.maximum(by_cells, by_steps).clamp(max=1)
        return float(torch.where(self.running, share, 1.0).mean())

    def _enter(self, state: State, counts: Bool[Tensor, "env agent_or_1"]) -> None:
        """Mark the cell under each robot as entered by it, in place, where `counts`."""
        cell = cell_index(state.position, self.env.rules.margin, state.blocked.shape[2])[..., None]
        before = self.entered.gather(2, cell)
        self.entered.scatter_(2, cell, before | counts[..., None])

    def _record_times(self, state: State) -> None:
        """Record the times whose condition this step is the first to meet."""
        for percent, time in self.reached.items():
            enough = self.num_visited >= bounds.need(percent, self.num_free)
            first = enough & (time == NEVER)
            self.reached[percent] = torch.where(first, state.step, time)
        if self.certify:
            uncertified = self.running & (self.certified_at == NEVER)
            reached = uncertified & certified(state, self.entered)
            self.certified_at = torch.where(reached, state.step, self.certified_at)

    def _stop(self, state: State, done: Bool[Tensor, " env"]) -> None:
        """End the measures where done, and the episode unless a clean house remains to certify."""
        self.measuring = self.measuring & ~done
        clean = self.num_visited >= self.num_free
        uncertified = (self.certified_at == NEVER) & (state.step < self.max_steps)
        self.running = self.running & (self.measuring | (self.certify & clean & uncertified))

    def records(self) -> list[Record]:
        """One record per house, in the order of the environments; the names are world.md's."""
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
        if self.spills is not None:
            columns |= self.spills.columns()
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
        measures: dict[str, list[int | float | None]] = {
            f"T_{name}": [None if step == NEVER else step for step in time.tolist()]
            for name, time in times.items()
        }
        for name in times:
            pairs = zip(measures[f"T_{name}"], self.bounds[f"bound_{name}"], strict=True)
            measures[f"ratio_{name}"] = [ratio(time, bound) for time, bound in pairs]
        if self.optima is not None:
            measures["optimum_100"] = list(self.optima)
            pairs = zip(measures["T_100"], self.optima, strict=True)
            measures["gap_100"] = [ratio(time, least) for time, least in pairs]
        return measures

    def _shares(self) -> dict[str, Tensor]:
        """The measures that are quotients of counts, as float64 [B]."""
        own = self.entered.sum(2)  # distinct cells of each robot
        distinct = self.entered.any(1).sum(1)
        cleaned = self.first_cleaned.to(torch.float64)
        # The coverage of the last step counts until max_steps: 1 in a clean house.
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


COSTS = ("messages", "edges", "bits", "rounds")  # reported per step, and per cell cleaned
RATES = ("contact", *COSTS)  # counted, and reported per step
COUNTED = ("bumps", "collisions", *RATES, "spoken", "speakable")


def step_counts(state: State, step: TensorDictBase) -> dict[str, Int[Tensor, " env"]]:
    """The counts of one step: bumps, collisions, and communication between the robots.

    An edge is a pair in contact when the actions were chosen; a message is what one robot sends
    along one of its edges in one round, so a step has two messages an edge and round, fewer where
    a robot chooses or has to be silent, and none without communication. A round counts where any
    robot sent. What robots tell each other of their maps as they meet after the step is a round of
    its own; patches are told before it. The gate's rate is the share of contacts over which a
    message was sent in the first round, for policies that communicate.
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
    told = told_bits = torch.zeros_like(cost[:, 0])
    if state.exchanged_bits is not None:
        of_patches = state.heard_record is not None
        told = (adjacency if of_patches else step["next"][ADJACENCY]).sum((1, 2))
        told_bits = state.exchanged_bits.sum(1)
    return {
        "bumps": state.bumped.sum(1),
        "collisions": state.collided.sum(1),
        "contact": adjacency.flatten(1).any(1).to(torch.int64),
        "messages": reached.sum(1) + told,
        "edges": degree.sum(1) // 2,
        "bits": cost.sum(1) + told_bits,
        "rounds": (reached > 0).sum(1) + (told > 0),
        "spoken": reached[:, 0] if sends else torch.zeros_like(degree[:, 0]),
        "speakable": degree.sum(1) if sends else torch.zeros_like(degree[:, 0]),
    }


def shares(counts: Int[Tensor, " env"], totals: Int[Tensor, " env"]) -> list[float | None]:
    """Each count divided by its total; null where that is 0."""
    pairs = zip(counts.tolist(), totals.tolist(), strict=True)
    return [count / total if total else None for count, total in pairs]


def certified(state: State, entered: Bool[Tensor, "env agent cell"]) -> Bool[Tensor, " env"]:
    """Whether no unknown cell is a 4-neighbour of a cell that some robot has stood on."""
    unknown = is_unknown(state.record).all(1)  # to every robot
    stood = entered.any(1).view_as(unknown)
    beside = neighbours(stood, False).any(0)
    return ~(beside & unknown).flatten(1).any(1)


def ratio(time: int | float | None, bound: int | None) -> float | None:
    """A time as a multiple of its bound; null without a time, or where the bound is 0 or null."""
    return time / bound if time is not None and bound else None


def episode_bounds(state: State, rules: Rules) -> dict[str, list[int | None]]:
    """The bounds on each T, for worlds at step 0; null where furniture moves.

    The bound on T_certify holds for blind robots only: `sensor=bump` and `knowledge=unknown`.
    """
    names = [f"bound_{percent}" for percent in PERCENTS] + ["bound_certify"]
    result: dict[str, list[int | None]] = {name: [None] * len(state.step) for name in names}
    if state.furniture_moves.shape[1] > 0:
        return result
    free, starts = grids_and_positions(state, rules)
    num_free, num_starts = free.sum(axis=(1, 2)), bounds.count_starts(starts)
    for percent in PERCENTS:
        least = bounds.bound_percent(percent, num_free, num_starts, starts.shape[1])
        result[f"bound_{percent}"] = least.tolist()
    result["bound_100"] = bounds.bound_100(free, starts).tolist()
    if rules.sensor is Sensor.BUMP and set(rules.kinds_of_knowledge) == {Knowledge.UNKNOWN}:
        result["bound_certify"] = bounds.bound_certify(free, starts).tolist()
    return result


def episode_optima(state: State, rules: Rules) -> list[int | None]:
    """The proven least T_100, for worlds at step 0; null where furniture moves or F is large."""
    if state.furniture_moves.shape[1] > 0:
        return [None] * len(state.step)
    return [
        optimal_T_100(free, starts) if free.sum() <= MOST_CELLS else None
        for free, starts in zip(*grids_and_positions(state, rules), strict=True)
    ]


def grids_and_positions(
    state: State, rules: Rules
) -> tuple[Bool[np.ndarray, "env row col"], Int[np.ndarray, "env agent 2"]]:
    """The free cells and the robots' positions, on the host."""
    inner = slice(rules.margin, -rules.margin)
    return (~state.blocked[:, inner, inner]).cpu().numpy(), state.position.cpu().numpy()
