"""`observation=global_map`: the whole map, for central controllers."""

from typing import final

import torch
from tensordict.utils import NestedKey
from torchrl.data import TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.house.base import check_largest
from marl_clean.observation._map import spread_codes, with_contacts
from marl_clean.observation.base import Observation
from marl_clean.settings import Form, HouseSide
from marl_clean.world.scales import marked, whole_map
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


@final
class GlobalMap(Observation):
    """A robot sees its whole map, and its own cell on a second plane.

    Adds `("agents", "observation")`, float32 `[*B, n, 2, L + 2, L + 2]`: the map's values, the
    house's ring at the upper and left edge, unknown where the house is smaller than L x L; and a
    plane that is 1 at the robot's own cell, else 0. Square, so that it can be rotated.

    L is a setting and not derived from the houses, since the network's size depends on it: weights
    trained with one L work in smaller houses and in no larger ones.

    Its cost grows with the house.

    Args:
        largest_side: L, the largest number of rows or columns of a house.

    Raises:
        BadInput: a house is larger.
    """

    gives = Form.SQUARES
    spread = staticmethod(spread_codes)

    def __init__(self, largest_side: HouseSide = 10) -> None:
        super().__init__()
        self.largest_side = largest_side

    def shape(self) -> tuple[int, ...]:
        return 2, self.largest_side + 2, self.largest_side + 2

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        check_largest(self.largest_side, *env.houses.free.shape[1:])
        return super().specs(env)

    def read(self, state: State, setup: Setup) -> Entries:
        known = whole_map(state.record, state.step, self.largest_side, setup.rules)
        view = known.expand(-1, state.n_agents, -1, -1)
        corner = torch.full_like(state.position, -1)  # the ring's
        view = with_contacts(view, corner, state, setup)
        own = marked(state.position, self.largest_side)
        return {keys.OBSERVATION: torch.stack([view, own], 2)}
