"""`marl-clean benchmark`: how fast worlds, envs and training run, as ratios within one run."""

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.table import Table
from torchrl.envs import TransformedEnv

from marl_clean import build, keys
from marl_clean.commands._benchmark_schemes import (
    N_AGENTS,
    WORLDS,
    Cost,
    costs_of_channels,
    costs_of_schemes,
    exponent,
    growth_of_schemes,
    ratios,
)
from marl_clean.commands._benchmark_training import (
    costs_of_training,
    table_of_training,
    wait_for,
)
from marl_clean.commands._jumanji_cleaner import cleaner
from marl_clean.config.compose import compose_config
from marl_clean.config.stored import RUNS
from marl_clean.evaluation.table import output
from marl_clean.storage import files
from marl_clean.world.dynamics import advance_
from marl_clean.world.sensing import crop

REPEATS = 15
STEPS = 200
ACTION_SETS = 32  # drawn before the clock starts, used in a cycle

Stepper = Callable[[int], None]
"""Runs a number of steps of a whole batch."""


@dataclass(frozen=True)
class Row:
    """One timed case.

    Attributes:
        what: the case in words.
        robot_steps_per_second: the median of the repeats; null where it could not be timed.
        milliseconds_per_step: of the whole batch.
        ratio, wanted: this row's figure divided by the one it is compared with, and the bound.
    """

    what: str
    robot_steps_per_second: float | None
    milliseconds_per_step: float | None
    ratio: float | None = None
    wanted: str = ""


def main(cfg: DictConfig) -> list[Row]:
    """Time worlds and envs of `cfg`'s rooms, print the table, write runs/benchmark.json."""
    console = output()
    rows = []
    for measure in (against_jumanji, over_house_sizes, over_robots):
        rows += measure(cfg)
    table = Table(title=f"random actions, 15x15 views, staggered resets; {machine()}")
    for title in ("what", "M robot-steps/s", "ms a step", "ratio", "wanted"):
        table.add_column(title, justify="left" if title == "what" else "right", no_wrap=True)
    for row in rows:
        million = row.robot_steps_per_second and row.robot_steps_per_second / 1e6
        table.add_row(
            row.what,
            _number(million),
            _number(row.milliseconds_per_step),
            _number(row.ratio),
            row.wanted,
        )
    console.print(table)
    messages = [costs_of_schemes(), costs_of_channels()]
    growth = growth_of_schemes()
    for shown in (*map(table_of_costs, messages), table_of_growth(growth)):
        console.print(shown)
    training = costs_of_training(cfg.device)
    console.print(table_of_training(training))
    path = RUNS / "benchmark.json"
    content = {
        "machine": machine(),
        "rows": [asdict(row) for row in rows],
        "talk": [asdict(cost) for costs in messages for cost in costs],
        "growth": growth,
        "training": [asdict(cost) for cost in training],
    }
    with files.writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_file(path, [json.dumps(content, indent=1).encode()])
    console.print(f"written to {path}")
    return rows


def table_of_costs(costs: list[Cost]) -> Table:
    """Updates and steps as multiples of the first row's."""
    table = Table(title=f"{N_AGENTS} robots; times against {costs[0].what}, wanted <= 1.50")
    for title in ("what", "parameters", "update, ms", "ratio", "step, ms", "ratio"):
        table.add_column(title, justify="left" if title == "what" else "right", no_wrap=True)
    for cost, update, step in ratios(costs):
        cells = (f"{cost.update:.2f}", f"{update:.2f}", f"{cost.step:.2f}", f"{step:.2f}")
        table.add_row(cost.what, f"{cost.parameters:,}", *cells)
    return table


def table_of_growth(growth: dict[str, dict[int, float]]) -> Table:
    """Milliseconds by the number of robots, and the exponent of their growth, wanted <= 2."""
    table = Table(title=f"forward pass of {WORLDS} worlds, everybody in contact, ms; wanted: n^2")
    teams = next(iter(growth.values()))
    for title in ("scheme", *(f"n={n}" for n in teams), "grows as"):
        table.add_column(title, justify="left" if title == "scheme" else "right", no_wrap=True)
    for level, times in growth.items():
        cells = [f"{taken:.2f}" for taken in times.values()]
        table.add_row(level, *cells, f"n^{exponent(times):.1f}")
    return table


def against_jumanji(cfg: DictConfig) -> list[Row]:
    """Time the bare world, the whole env and Jumanji's Cleaner: 1,024 x 3 robots on 20x20."""
    num_envs, n_agents, side = 1024, 3, 20
    sizes = (num_envs, n_agents, side)
    steps, case = num_envs * n_agents, f"{num_envs} worlds x {n_agents}, {side}x{side}"
    steppers = [world_stepper(case_env(cfg, *sizes)), env_stepper(case_env(cfg, *sizes))]
    jumanji = cleaner(*sizes)
    world, whole, *relative = interleaved([*steppers, jumanji] if jumanji else steppers)
    rows = [Row("Jumanji: not installed", None, None)]
    if relative:
        seconds = statistics.median(relative[0])
        rows = [Row(f"Jumanji Cleaner, no view, {case}", steps / seconds, seconds * 1e3)]
    for what, taken, wanted in (("world functions", world, 1.0), ("whole env", whole, 0.5)):
        seconds = statistics.median(taken)
        ratio = median_ratio(relative[0], taken) if relative else None
        bound = f">= {wanted:.2f} of Jumanji"
        rows.append(Row(f"{what}, {case}", steps / seconds, seconds * 1e3, ratio, bound))
    return rows


def over_house_sizes(cfg: DictConfig) -> list[Row]:
    """Time the whole env in small and in large houses: the cost must follow the view."""
    cases = {f"256 worlds, {side}x{side}": (256, 3, side) for side in (20, 200)}
    (small, large), ratio = whole_envs(cfg, cases)
    return [small, replace(large, ratio=ratio, wanted="<= 2.00 of 20x20")]


def over_robots(cfg: DictConfig) -> list[Row]:
    """Time the whole env with few and with many robots: the cost must follow their number."""
    cases = {f"1024 worlds, {robots} robots": (1024, robots, 20) for robots in (2, 16)}
    (few, many), ratio = whole_envs(cfg, cases)
    return [few, replace(many, ratio=ratio * 2 / 16, wanted="<= 1.30 a robot")]


def whole_envs(cfg: DictConfig, cases: dict[str, tuple[int, int, int]]) -> tuple[list[Row], float]:
    """Time envs of (worlds, robots, side); return rows, and the last's time over the first's."""
    taken = interleaved([env_stepper(case_env(cfg, *sizes)) for sizes in cases.values()])
    rows = []
    for (case, (num_envs, n_agents, _)), times in zip(cases.items(), taken, strict=True):
        seconds = statistics.median(times)
        rows.append(Row(f"whole env, {case}", num_envs * n_agents / seconds, seconds * 1e3))
    return rows, median_ratio(taken[-1], taken[0])


def case_env(cfg: DictConfig, num_envs: int, n_agents: int, side: int) -> TransformedEnv:
    """Build the compiled env of `cfg`'s rooms in houses of rooms, side x side."""
    case = cfg.copy()
    case.house = compose_config(
        [f"house.rows=[{side},{side}]", f"house.cols=[{side},{side}]"]
    ).house
    case.env.compile, case.env.n_agents, case.train_houses = True, n_agents, 64
    return build.make_env(case, num_envs=num_envs)


def actions(env: TransformedEnv) -> list[torch.Tensor]:
    """Draw the actions of some steps."""
    generator = torch.Generator().manual_seed(0)
    shape = (env.base_env.num_envs, env.base_env.n_agents)
    draws = (torch.randint(0, 4, shape, generator=generator) for _ in range(ACTION_SETS))
    return [draw.to(env.device) for draw in draws]


def world_stepper(env: TransformedEnv) -> Stepper:
    """Return a function that computes steps and views by the world's functions alone."""
    env.reset()
    base, drawn = env.base_env, actions(env)
    step, sense = base.compiled(advance_), base.compiled(crop, wide=True)
    view_size = env.transform[1].view_size

    def run(count: int) -> None:
        state = base.state
        for index in range(count):
            step(state, drawn[index % ACTION_SETS], base.moves, base.rules)
            sense(state.record, state.position, state.step, view_size, base.rules)
        wait_for(env.device)

    return run


def env_stepper(env: TransformedEnv) -> Stepper:
    """Return a function that calls `step_and_maybe_reset`; at every step some worlds reset."""
    carried = env.reset()
    base, drawn = env.base_env, actions(env)
    ages = torch.arange(base.num_envs, device=env.device) % 100
    base.state.last_progress = base.state.step - ages  # so that episodes do not all end together

    def run(count: int) -> None:
        nonlocal carried
        for index in range(count):
            carried[keys.ACTION] = drawn[index % ACTION_SETS]
            carried = env.step_and_maybe_reset(carried)[1]
        wait_for(env.device)

    return run


def interleaved(steppers: Sequence[Stepper]) -> list[list[float]]:
    """Return the seconds per step of every repeat of each, their repeats interleaved.

    A busy machine's speed varies by more than what is compared; here for all alike.
    """
    taken: list[list[float]] = [[] for _ in steppers]
    for run in steppers:
        run(STEPS)
    for _ in range(REPEATS):
        for run, times in zip(steppers, taken, strict=True):
            began = time.perf_counter()
            run(STEPS)
            times.append((time.perf_counter() - began) / STEPS)
    return taken


def median_ratio(times: Sequence[float], baseline: Sequence[float]) -> float:
    """Return the median ratio of times that were measured side by side."""
    return statistics.median(a / b for a, b in zip(times, baseline, strict=True))


def machine() -> str:
    """Return the machine that the figures are from."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].partition(":")[2].strip() if names else cpu
    return f"{cpu}, {os.cpu_count()} cores, torch {torch.__version__}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
