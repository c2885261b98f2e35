"""What is kept of the floor plans that a command uses, a line each on stderr."""

import sys
from collections.abc import Iterable

import torch
from omegaconf import DictConfig

from marl_clean.config.compose import has_houses
from marl_clean.config.schema import instantiate
from marl_clean.env.houses import step_limits
from marl_clean.house.base import House, HouseLayout
from marl_clean.house.floorplan import FloorPlan


def write_plan_lines(cfg: DictConfig, others: Iterable[str] = ()) -> None:
    """Write what is kept of each floor plan of the config's house, and of `others` by path.

    Generated houses need no such line.
    """
    for layout in floor_plans(cfg, others):
        sys.stderr.write(f"{plan_line(layout)}\n")
    sys.stderr.flush()


def write_evaluation_lines(cfg: DictConfig) -> None:
    """Write the same with the number of starts, and the steps that an episode lasts at most."""
    for layout in floor_plans(cfg):
        rows, cols = (torch.tensor([side]) for side in layout.free.shape)
        steps = int(step_limits(rows, cols, cfg.env.n_agents, cfg.env.max_steps))
        starts = "1 start" if cfg.evaluation.houses == 1 else f"{cfg.evaluation.houses:,} starts"
        sys.stderr.write(f"{plan_line(layout)}; {starts} of at most {steps:,} steps\n")
    sys.stderr.flush()


def floor_plans(cfg: DictConfig, others: Iterable[str] = ()) -> list[HouseLayout]:
    """The floor plans of the config's house and those at `others`, each once."""
    if not has_houses(cfg):
        return []
    houses: list[House] = [*instantiate(cfg.house).parts(), *(FloorPlan(path) for path in others)]
    layouts = [house.layout(0) for house in houses if not house.generated]
    return list({layout.source: layout for layout in layouts}.values())


def plan_line(layout: HouseLayout) -> str:
    """Where a floor plan comes from, its size, what is kept of it and what is left out."""
    return f"{layout.source}: {layout.regions().describe(layout.cell_metres)}"
