"""`observation=crop`: the paper's."""

from typing import final

from jaxtyping import Int
from torch import Tensor

from marl_clean import keys
from marl_clean.observation._map import spread_codes, with_contacts
from marl_clean.observation.base import Observation
from marl_clean.settings import Form, OddInt, Probability
from marl_clean.world.noise import believed_position
from marl_clean.world.sensing import crop
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


@final
class Crop(Observation):
    """A robot sees the square of its map around itself, itself in the middle (paper §3.2).

    Adds `("agents", "observation")`, float32 `[*B, n, 1, K, K]` with the map's values: -1 blocked,
    -0.2 unknown, 0 dirty to 0.5 just cleaned, 1 a robot.

    Args:
        view_size: K, the side of the square in cells, odd.
        position_noise: probability, for each step and robot, that the robot takes one of the four
            neighbouring cells of the house for its own, and sees the square around that cell. Its
            map is written at the true place.
    """

    gives = Form.SQUARES
    spread = staticmethod(spread_codes)

    def __init__(self, view_size: OddInt = 15, position_noise: Probability = 0.0) -> None:
        super().__init__()
        self.view_size = view_size
        self.position_noise = position_noise
        self.reach_cells = view_size // 2

    def shape(self) -> tuple[int, ...]:
        return 1, self.view_size, self.view_size

    def read(self, state: State, setup: Setup) -> Entries:
        centre = self.centre(state, setup)
        view = crop(state.record, centre, state.step, self.view_size, setup.rules)
        view = with_contacts(view, centre - self.view_size // 2, state, setup)
        return {keys.OBSERVATION: view.unsqueeze(2)}

    def centre(self, state: State, setup: Setup) -> Int[Tensor, "env agent 2"]:
        """Return the place that each robot takes for its own, the middle of what it sees."""
        if self.position_noise == 0:
            return state.position
        return believed_position(state, setup.env_index, setup.seed, self.position_noise)
