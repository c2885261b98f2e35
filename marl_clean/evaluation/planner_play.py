"""A planner in held-out houses, its maps merged over the contacts that a channel lets through."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import torch
from jaxtyping import Bool
from omegaconf import DictConfig
from torch import Tensor

from marl_clean import build
from marl_clean.channel.base import Channel
from marl_clean.channel.perfect import Perfect
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.evaluation import bounds
from marl_clean.evaluation.evaluator import CELLS_AT_ONCE, held_out_env
from marl_clean.evaluation.metrics import NEVER, Record
from marl_clean.learning.delivery import Stacked
from marl_clean.planner.base import Planner
from marl_clean.world.random import Purpose, random_bits, words_of_robots
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import distance_rank
from marl_clean.world.setup import Contact
from marl_clean.world.state import State

OnShare = Callable[[float], object]
PERCENTS = (90, 100)


@contextmanager
def one_thread() -> Iterator[None]:
    """Within this context torch computes by one thread: in small worlds more wait for each other.

    On two busy cores a grid took four times the processor time by two threads.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def play(cfg: DictConfig, on_share: OnShare | None = None) -> list[Record]:
    """One episode of `cfg.planner` in each of the houses of `cfg.evaluation`; a record a house.

    Records have what times are counted by alone, `T_90`, `T_100` and `max_steps`, equal to those
    of `evaluate`: without frames for a network, a step takes half as long.
    """
    section = cfg.evaluation
    houses = build.held_out_houses(cfg, section.house_set, section.houses)
    channels = list(build.make_channels(cfg, (0,)).values())
    at_once = max(1, CELLS_AT_ONCE // (houses.free[0].size * cfg.env.n_agents))
    records: list[Record] = []
    for first in range(0, section.houses, at_once):
        num_envs = min(at_once, section.houses - first)
        env = held_out_env(cfg, houses, section.house_set, num_envs, first)
        cleaning = env.base_env
        assert isinstance(cleaning, CleaningEnv) and cleaning.setup.contact is not None
        heard = arriving(cleaning.setup.contact, channels, cleaning)
        cleaning.setup = cleaning.setup._replace(contact=heard)
        records += _episodes(cleaning, build.make_planner(cfg, env))
        if on_share is not None:
            on_share(len(records) / section.houses)
    return records


def _episodes(env: CleaningEnv, planner: Planner) -> list[Record]:
    """One episode in every world of an env, which is left with the last of them."""
    env.begin_rows(torch.arange(env.num_envs, device=env.device))
    max_steps = env.state.max_steps.clone()
    reached = {percent: torch.full_like(max_steps, NEVER) for percent in PERCENTS}
    world = torch.arange(env.num_envs, device=env.device)  # which of them each one that is left is
    while True:
        state = env.state
        for percent, time in reached.items():
            first = (state.num_visited >= bounds.need(percent, state.num_free)) & (time[world] < 0)
            time[world[first]] = state.step[first]
        running = (reached[100][world] == NEVER) & (state.step < state.max_steps)
        left = running.nonzero()[:, 0]
        if not len(left):
            break
        if len(left) <= len(world) // 2:  # most are done: go on with the others alone
            world = world[left]
            env.state, env.setup = state.rows_of(left), env.setup.of_rows(left)
            planner.restore({name: kept[left] for name, kept in planner.memory().items()})
        env.step_worlds(planner.act())
    times = {
        f"T_{percent}": [None if step == NEVER else step for step in time.tolist()]
        for percent, time in reached.items()
    }
    columns = {"max_steps": max_steps.tolist(), **times}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def arriving(contact: Contact, channels: Sequence[Channel], env: CleaningEnv) -> Contact:
    """Return the contacts over which a map arrives, one message an edge and step.

    For the env whose worlds it reads: draws are functions of seed, world, episode and step, as
    those of messages are.
    """

    if all(type(channel) is Perfect for channel in channels):
        return contact

    def heard(state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        edges = contact(state, rules)
        words = words_of_robots(state, env.env_index, Purpose.CHANNEL)
        seed = random_bits(env.seed_in_use, *words)
        rank = distance_rank(state.position)
        delivery = Stacked(channels, edges, rank, 1, seed, [None] * len(channels))
        nothing = torch.zeros((*edges.shape[:2], 0), device=edges.device)
        return delivery(nothing, 0)[1]

    return heard
