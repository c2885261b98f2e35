"""What stays as it is while a batch of worlds is stepped; `State` is what changes."""

from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.settings import HouseOrder
from marl_clean.world.exchange import Exchange
from marl_clean.world.lending import Lending
from marl_clean.world.patches import Patches
from marl_clean.world.random import Seed
from marl_clean.world.rules import Rules
from marl_clean.world.state import State

Contact = Callable[[State, Rules], Bool[Tensor, "env agent agent"]]
"""Which robots are in contact: a topology's `contact`."""

Telling = Exchange | Lending | Patches
"""What robots in contact tell each other of their private maps."""


class HouseTensors(NamedTuple):
    """The houses episodes draw from, padded by `margin` blocked cells on every side."""

    blocked: Bool[Tensor, "house height width"]
    piece: Int[Tensor, "house height width"]  # int16
    num_pieces: Int[Tensor, " house"]
    rows: Int[Tensor, " house"]
    cols: Int[Tensor, " house"]
    free_labels: Int[Tensor, "house most"]  # row * LARGEST_SIDE + col of free cells, -1 beyond
    num_free: Int[Tensor, " house"]
    max_steps: Int[Tensor, " house"]
    starts: Int[Tensor, "house agent 2"]  # (row, col) given by the house, -1 where drawn


class FurnitureMoves(NamedTuple):
    """How often furniture is moved."""

    during_episode: int = 0
    before_start: int = 0  # after the robots memorised the house (`knowledge=stale`)


class Setup(NamedTuple):
    """What worlds are stepped by and begin from; with their state it decides all that follows."""

    rules: Rules
    houses: HouseTensors
    env_index: Int[Tensor, " env"]  # of each world; what is drawn in it depends on it
    seed: Seed
    house_order: HouseOrder = HouseOrder.RANDOM
    num_open: int = 1  # new episodes draw their house among the first so many
    furniture: FurnitureMoves = FurnitureMoves()
    contact: Contact | None = None
    exchange: Telling | None = None  # of private maps between robots in contact

    def of_rows(self, rows: Int[Tensor, " row"]) -> "Setup":
        """Return the setup of the worlds `rows` alone."""
        return self._replace(env_index=self.env_index[rows])
