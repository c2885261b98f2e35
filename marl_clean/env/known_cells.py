"""What robots know of the cells around them, as a transform: what messages can be grounded in."""

import torch
from jaxtyping import Float
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.patches import CLEANED, REACH_CELLS, SIDE, UNKNOWN, classes
from marl_clean.world.sensing import windows_around
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries

NOT_ASKED = -1


class KnownCells(WorldTransform):
    """Adds what messages are grounded in, for losses alone; no policy sees it.

    `("agents", "known")`, int8 `[*B, n, 7, 7]`: each cell around a robot by the map that it reads:
    0 unknown, 1 blocked, 2 available and not cleaned in this episode, 3 cleaned.
    `("agents", "missing")`, int8 `[*B, n, n, 7, 7]`, at [i, j]: each cell around i by the map of j,
    or -1 where i knows the cell itself.

    Args:
        sender_map, missing: whether the one and the other are added.
    """

    def __init__(self, sender_map: bool, missing: bool) -> None:
        super().__init__()
        self.sender_map, self.missing = sender_map, missing

    def read(self, state: State, setup: Setup) -> Entries:
        known = classes(windows_around(state.record, state.position, SIDE, setup.rules.margin))
        entries: Entries = {keys.KNOWN: known} if self.sender_map else {}
        if self.missing:
            by_others = classes(_all_windows(state, setup.rules.margin))
            asked = (known == UNKNOWN).unsqueeze(-3)
            entries[keys.MISSING] = torch.where(asked, by_others, NOT_ASKED)
        return entries

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        robots = (env.num_envs, env.n_agents)
        asked = [(keys.KNOWN, robots)] if self.sender_map else []
        pairs = [(keys.MISSING, (*robots, env.n_agents))] if self.missing else []
        return {
            key: Bounded(
                NOT_ASKED, CLEANED, (*whose, SIDE, SIDE), device=env.device, dtype=torch.int8
            )
            for key, whose in (*asked, *pairs)
        }


def _all_windows(state: State, margin: int) -> Float[Tensor, "env agent other row col"]:
    """The square around each robot in the map of each."""
    windows = state.record.unfold(-2, SIDE, 1).unfold(-2, SIDE, 1)
    row, col = (state.position + margin - REACH_CELLS).unbind(-1)
    env = torch.arange(len(row), device=row.device)[:, None, None]
    maps = torch.arange(state.record.shape[1], device=row.device).expand(row.shape[1])
    return windows[env, maps, row[..., None], col[..., None]]
