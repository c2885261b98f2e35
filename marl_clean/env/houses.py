"""From drawn houses (NumPy) to the tensors that episodes start from."""

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from marl_clean.errors import BadInput
from marl_clean.house.base import Houses
from marl_clean.settings import LARGEST_SIDE
from marl_clean.world.setup import HouseTensors
from marl_clean.world.state import pad_house


def house_tensors(
    houses: Houses, n_agents: int, max_steps: int | None, margin: int, device: torch.device
) -> HouseTensors:
    """Pad the houses by `margin` blocked cells and list their free cells.

    `max_steps` null: see `step_limits`, of each house's own R and C.

    Raises:
        BadInput: a house has no more free cells than there are robots.
    """
    free_counts = houses.free_cells
    if free_counts.min() <= n_agents:
        raise BadInput(
            f"env.n_agents={n_agents}: a house has {free_counts.min()} free cells; "
            "it needs more of them than robots"
        )
    free = pad_house(torch.from_numpy(houses.free), margin, False)
    rows, cols = torch.from_numpy(houses.rows), torch.from_numpy(houses.cols)
    flat = free.flatten(1)
    labels = torch.full((len(free), int(free_counts.max())), -1)
    house, row, col = free.nonzero(as_tuple=True)
    place = flat.cumsum(1)[house, row * free.shape[2] + col] - 1
    labels[house, place] = (row - margin) * LARGEST_SIDE + col - margin
    return HouseTensors(
        blocked=~free.to(device),
        piece=pad_house(torch.from_numpy(houses.furniture.astype(np.int16)), margin, 0).to(device),
        num_pieces=torch.from_numpy(houses.furniture.max((1, 2)).astype(np.int64)).to(device),
        rows=rows.to(device),
        cols=cols.to(device),
        free_labels=labels.to(device),
        num_free=flat.sum(1).to(device),
        max_steps=step_limits(rows, cols, n_agents, max_steps).to(device),
        starts=_plan_starts(houses, n_agents).to(device),
    )


def step_limits(
    rows: Int[Tensor, " house"], cols: Int[Tensor, " house"], n_agents: int, max_steps: int | None
) -> Int[Tensor, " house"]:
    """Steps after which an episode is truncated: `max_steps`, or null: 4 R C // n_agents + 50."""
    limits = 4 * rows * cols // n_agents + 50
    return limits if max_steps is None else torch.full_like(limits, max_steps)


def _plan_starts(houses: Houses, n_agents: int) -> Tensor:
    """Return [house, agent, 2]: the plan's first starts, -1 for those to be drawn."""
    starts = torch.full((len(houses.free), n_agents, 2), -1)
    if houses.starts is not None:
        of_plan = torch.from_numpy(houses.starts)[:, :n_agents]
        starts[:, : of_plan.shape[1]] = of_plan
    return starts
