"""One world of a batch as a `Scene` to draw."""

import numpy as np
import torch

from marl_clean.env.viewer import Scene
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import map_value, union_of_maps
from marl_clean.world.state import State


def scene_of(
    state: State, rules: Rules, env_index: int, contact: torch.Tensor | None = None
) -> Scene:
    """Copy world `env_index` to the host: truth, the union of the robots' maps, contacts.

    `contact`: bool [env, agent, agent] of the batch, where edges are to be drawn.
    """
    world = state.rows_of(torch.tensor([env_index], device=state.step.device))
    margin = rules.margin
    rows = slice(margin, margin + int(world.rows))
    cols = slice(margin, margin + int(world.cols))

    def house(matrix: torch.Tensor) -> np.ndarray:
        return matrix[0, rows, cols].cpu().numpy()

    now = (world.step + 1).to(world.record.dtype)
    edges = [] if contact is None else contact[env_index].triu().nonzero().tolist()
    return Scene(
        free=~house(world.blocked),
        furniture=house(world.piece),
        cleaned=house(world.visited),
        values=house(map_value(union_of_maps(world.record), now[:, None, None], rules)),
        positions=[(row, col) for row, col in world.position[0].tolist()],
        step=int(world.step),
        coverage=float(world.num_visited / world.num_free),
        contacts=[(first, second) for first, second in edges],
        map_title="shared map" if world.record.shape[1] == 1 else "all maps united",
        spilt=None if world.spilt is None else house(world.spilt),
    )
