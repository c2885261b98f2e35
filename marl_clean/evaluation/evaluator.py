"""Any policy on held-out houses: house i is environment i, from the same starts for every policy.

Nothing here draws from a global generator, so measuring in the middle of a training run does
not change what the run learns.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial

import torch
from jaxtyping import Int
from omegaconf import DictConfig
from torch import Tensor, nn
from torchrl.envs import TransformedEnv

from marl_clean import build
from marl_clean.config.compose import has_houses
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import read_level
from marl_clean.config.schema import instantiate
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.evaluation.episodes import RANDOM, measure_return
from marl_clean.evaluation.metrics import Record, Recorder
from marl_clean.evaluation.records import Entry, make_entry, means
from marl_clean.evaluation.rollouts import Explore, first_frame, rollout_episodes
from marl_clean.house.base import Houses
from marl_clean.settings import HouseOrder
from marl_clean.world.random import Purpose, random_below, random_bits, words_of_robots

PolicyFor = Callable[[TransformedEnv], nn.Module]  # a planner is bound to its env, a network is not
OnProgress = Callable[[str, float], object]  # a policy's name, and the share that is measured

START_SEEDS = {"validation": 2**31 + 1, "test": 2**31 + 2}
"""Seeds of the starts in held-out houses: above every run's own seed and different for each split,
so that a plan's validation episodes are neither those of its test nor of training."""
CELLS_AT_ONCE = 4_000_000  # bounds the memory to some hundred MB
YARDSTICKS: tuple[tuple[str, dict[str, str]], ...] = (
    ("random", {}),
    ("nearest_unknown", {}),
    ("nearest_unknown", {"assignment": "greedy"}),
)


def evaluate(
    cfg: DictConfig,
    policy_for: PolicyFor,
    *,
    house_set: str,
    count: int,
    epsilon: float = 0.0,
    certify: bool = False,
    optimum: bool = False,
    seeded: bool = False,
    on_share: Callable[[float], object] | None = None,
) -> list[Record]:
    """Run one episode in each of a split's first `count` houses; a plan is started `count` times.

    Returns one record a house, with its seed or path: every measure, its bounds and its size.
    `epsilon` is the share of random actions, drawn for each robot. With `optimum` the proven
    least T_100 is computed first, which takes up to a minute a house, once in a process.
    `seeded`: frames hold draws for channels, whether or not the config's own channel draws.
    `on_share` is called after each step with the share that is done.
    """
    houses = build.held_out_houses(cfg, house_set, count)
    cells = houses.free.shape[1] * houses.free.shape[2]
    at_once = max(1, CELLS_AT_ONCE // cells)
    records = []
    for first in range(0, count, at_once):
        num_envs = min(at_once, count - first)
        env = held_out_env(cfg, houses, house_set, num_envs, first, seeded)
        on_part = None if on_share is None else _of_part(on_share, first, num_envs, count)
        measured = run_episodes(env, policy_for(env), epsilon, certify, optimum, on_part)
        for index, record in enumerate(measured, start=first):
            source = houses.sources[index % len(houses)]
            records.append({source_key(source): source, **record})
    return records


def _of_part(
    on_share: Callable[[float], object], first: int, num_envs: int, count: int
) -> Callable[[float], object]:
    """Report the share of some houses as a share of all."""
    return lambda share: on_share((first + share * num_envs) / count)


def held_out_env(
    cfg: DictConfig,
    houses: Houses,
    house_set: str,
    num_envs: int,
    first: int = 0,
    seeded: bool = False,
) -> TransformedEnv:
    """The env of held-out houses `first`, `first + 1`, ...: house i is environment i.

    The number of envs that run together changes no episode.
    """
    env = build.make_env(
        cfg,
        houses,
        num_envs=num_envs,
        first_env=first,
        house_order=HouseOrder.FIXED,
        never_stuck=True,
        seeded=seeded,
        shaped=False,
    )
    env.set_seed(START_SEEDS[house_set])
    return env


def validate(cfg: DictConfig, policy: nn.Module) -> dict[str, float]:
    """The means by which training chooses its weights: on validation houses, as in tests.

    Of an external task: its return.
    """
    if not has_houses(cfg):
        entry = measure_return(cfg, policy, cfg.name, START_SEEDS["validation"])
        mean = entry["summary"]["return"]["mean"]
        return {"return": math.nan if mean is None else mean}
    section = cfg.evaluation
    records = evaluate(
        cfg,
        lambda env: policy,
        house_set="validation",
        count=section.houses,
        epsilon=section.epsilon,
    )
    return means(records)


def measure(
    cfg: DictConfig,
    policy_for: PolicyFor,
    name: str,
    *,
    epsilon: float = 0.0,
    seeded: bool = False,
    on_progress: OnProgress | None = None,
) -> Entry:
    """One entry of evaluation.json: a policy on the houses of `cfg.evaluation`."""
    section = cfg.evaluation
    records = evaluate(
        cfg,
        policy_for,
        house_set=section.house_set,
        count=section.houses,
        epsilon=epsilon,
        certify=section.certify,
        optimum=section.get("optimum", False),
        seeded=seeded,
        on_share=None if on_progress is None else partial(on_progress, name),
    )
    generated = instantiate(cfg.house).generated
    house_set = section.house_set if generated else str(records[0]["path"])
    return make_entry(name, house_set, config_hash(cfg), epsilon, cfg.env.n_agents, records)


def measure_planner(cfg: DictConfig, on_progress: OnProgress | None = None) -> Entry:
    """The entry of `cfg.planner`, under its label; planners do not explore.

    Raises BadInput where there are no houses to plan in.
    """
    if not has_houses(cfg):
        raise BadInput("checkpoint=null: planners need houses, which env has none of; give a run")
    name = instantiate(cfg.planner).label
    return measure(cfg, lambda env: build.make_planner(cfg, env), name, on_progress=on_progress)


def measure_beside_planners(
    cfg: DictConfig, policy: nn.Module, name: str, on_progress: OnProgress | None = None
) -> Iterator[Entry]:
    """A learned policy, then random and nearest_unknown (none, greedy) on the same houses.

    Each is measured lazily. On an external task, random alone.
    """
    if not has_houses(cfg):
        seed = START_SEEDS[cfg.evaluation.house_set]
        both: tuple[tuple[nn.Module | None, str], ...] = ((policy, name), (None, RANDOM))
        yield from (measure_return(cfg, actor, label, seed) for actor, label in both)
        return
    epsilon = cfg.evaluation.epsilon
    yield measure(cfg, lambda env: policy, name, epsilon=epsilon, on_progress=on_progress)
    for planner, settings in YARDSTICKS:
        planned = cfg.copy()
        planned.planner = {**read_level("planner", planner), **settings}
        yield measure_planner(planned, on_progress)


def run_episodes(
    env: TransformedEnv,
    policy: nn.Module,
    epsilon: float,
    certify: bool,
    optimum: bool = False,
    on_share: Callable[[float], object] | None = None,
) -> list[Record]:
    """One episode in every environment, epsilon-greedily; its records in their order."""
    first = first_frame(env, policy)
    recorder = Recorder(env.base_env, certify, optimum)
    steps = rollout_episodes(
        env,
        policy,
        first,
        explore=exploring(env.base_env, epsilon),
        running=lambda: recorder.running,
    )
    for step in steps:
        recorder.update(step)
        if on_share is not None:
            on_share(recorder.share_done())
    return recorder.records()


def exploring(env: CleaningEnv, epsilon: float) -> Explore | None:
    """The function that replaces a share of the actions; None where epsilon is 0."""
    return partial(with_random_actions, env, epsilon=epsilon) if epsilon > 0 else None


def with_random_actions(
    env: CleaningEnv, action: Int[Tensor, "env agent"], epsilon: float
) -> Int[Tensor, "env agent"]:
    """Replace each robot's action with probability epsilon by one of the four.

    A pure function of (seed, env, episode, step, robot), like all draws of the world.
    """
    words = (env.seed_in_use, *words_of_robots(env.state, env.env_index, Purpose.ACTION))
    explores = random_bits(*words, 0) < round(epsilon * 2**32)
    return torch.where(explores, random_below(4, *words, 1), action)


def in_any_env(policy: nn.Module, env: TransformedEnv) -> nn.Module:
    """The policy for an env: a network is the same in all envs."""
    return policy


def source_key(source: int | str) -> str:
    """The key of a house's source in its record."""
    return "seed" if isinstance(source, int) else "path"
