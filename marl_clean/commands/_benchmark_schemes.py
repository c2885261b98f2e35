"""What communication costs in time: schemes and channels against none, growth with robots."""

import math
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import build, keys
from marl_clean.comm.base import Senders
from marl_clean.config.compose import compose_config
from marl_clean.config.levels import rooms
from marl_clean.learning.agent import Agent

REPEATS = 9
N_AGENTS = 4
NUM_ENVS = 32
FRAMES = 128  # learnt from in one update, as by default
TEAMS = (2, 4, 8, 16, 32, 64)
WIDTH = 128  # of the features that schemes receive
WORLDS = 8  # of those teams


@dataclass
class Cost:
    """Milliseconds of an update and of a step of env and policy, and the network's size."""

    what: str
    update: float
    step: float
    parameters: int


def costs_of_schemes() -> list[Cost]:
    """Time every scheme with 4 robots; the first is `none`."""
    levels = ["none", *(level for level in rooms()["comm"] if level != "none")]
    return timed({f"comm={level}": [f"comm={level}"] for level in levels})


def costs_of_channels() -> list[Cost]:
    """Time every channel under `plan` with 4 robots; the first is `perfect`."""
    levels = ["perfect", *(level for level in rooms()["channel"] if level != "perfect")]
    return timed({f"channel={level}": [f"channel={level}"] for level in levels})


def timed(cases: dict[str, list[str]]) -> list[Cost]:
    """Time updates and steps of all cases interleaved, so that a busy machine slows all alike."""
    parts = {name: prepared(settings) for name, settings in cases.items()}
    updates: dict[str, list[float]] = {name: [] for name in cases}
    steps: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(REPEATS + 1):
        for name, (update, step, _) in parts.items():
            updates[name].append(milliseconds(update))
            steps[name].append(milliseconds(step))
    return [
        Cost(
            name,
            statistics.median(updates[name][1:]),
            statistics.median(steps[name][1:]),
            sum(weight.numel() for weight in agent.network.parameters()),
        )
        for name, (_, _, agent) in parts.items()
    ]


def prepared(settings: list[str]) -> tuple[Callable[[], None], Callable[[], None], Agent]:
    """Return an update, a step, and the agent of both."""
    team = [f"env.n_agents={N_AGENTS}", f"env.num_envs={NUM_ENVS}", "train_houses=64"]
    cfg = compose_config([*team, *settings])
    torch.manual_seed(0)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    env = build.ready_for(agent, env)
    policy = agent.policy()
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(8, policy, break_when_any_done=False)
        carried = env.reset()
    batch = learnable(agent, rollout)

    def step() -> None:
        nonlocal carried
        with torch.no_grad():
            _, carried = env.step_and_maybe_reset(policy(carried))

    def update() -> None:
        agent.update(batch.clone())

    return update, step, agent


def learnable(agent: Agent, rollout: TensorDictBase) -> TensorDictBase:
    """Return as many frames as an update has, in rows if the agent learns from rows."""
    frames = rollout.select(*agent.learns_from)
    frames[keys.STEPS_TO_NEXT_OBS] = torch.ones(frames.batch_size, dtype=torch.int64)
    rows = frames[: FRAMES // frames.shape[1]]
    return (rows if agent.unrolls else rows.flatten()).contiguous()


def growth_of_schemes() -> dict[str, dict[int, float]]:
    """Milliseconds of every scheme's forward pass by the number of robots, all in contact."""
    schemes = {}
    for level in rooms()["comm"]:
        section = compose_config([f"comm={level}"]).comm
        schemes[level] = build.make_comm(section, WIDTH, torch.Size([1, 15, 15])).eval()
    taken: dict[str, dict[int, float]] = {level: {} for level in schemes}
    for n_agents in TEAMS:
        feature = torch.randn(WORLDS, n_agents, WIDTH)
        live = (~torch.eye(n_agents, dtype=torch.bool)).expand(WORLDS, -1, -1)
        robot = torch.arange(n_agents)
        rank = ((robot - robot[:, None]) % n_agents).expand(WORLDS, -1, -1)
        senders = Senders(rank, torch.stack([rank, -rank], -1))
        samples: dict[str, list[float]] = {level: [] for level in schemes}
        with torch.no_grad():
            for _ in range(REPEATS + 1):
                for level, comm in schemes.items():
                    samples[level].append(milliseconds(partial(comm, feature, live, senders)))
        for level, times in samples.items():
            taken[level][n_agents] = statistics.median(times[1:])
    return taken


def exponent(times: dict[int, float]) -> float:
    """The exponent of the time's growth with the number of robots, over the last three sizes."""
    *_, before, _, last = times
    return math.log(times[last] / times[before]) / math.log(last / before)


def milliseconds(work: Callable[[], object]) -> float:
    """Return how long one call takes."""
    began = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - began)


def ratios(costs: Iterable[Cost]) -> list[tuple[Cost, float, float]]:
    """Each cost with its update and step as multiples of the first's."""
    costs = list(costs)
    first = costs[0]
    return [(cost, cost.update / first.update, cost.step / first.step) for cost in costs]
