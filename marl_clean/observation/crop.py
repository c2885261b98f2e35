"""`observation=crop`: the paper's."""

from tensordict.utils import NestedKey
from torch import Tensor

from marl_clean import keys
from marl_clean.observation.base import Observation
from marl_clean.settings import Form, Memory, OddInt, Probability
from marl_clean.world.noise import believed_position
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import crop, mark_contacts
from marl_clean.world.state import State
from marl_clean.world.turn import Reader


class Crop(Observation):
    """A robot sees the square of its map around itself, itself in the middle (paper §3.2).

    Adds `("agents", "observation")`, float32 `[*B, n, 1, K, K]` with the map's values: -1 blocked,
    -0.2 unknown, 0 dirty to 0.5 just cleaned, 1 a robot.

    Args:
        view_size: K, the side of the square in cells, odd.
        position_noise: probability, for each step and robot, that the robot thinks that it is on
            one of the four neighbouring cells of the house, and sees the square around that one.
            Its map is written at the true place.
    """

    gives = Form.SQUARES

    def __init__(self, view_size: OddInt = 15, position_noise: Probability = 0.0) -> None:
        super().__init__()
        self.view_size = view_size
        self.position_noise = position_noise
        self.reach_cells = view_size // 2

    def shape(self) -> tuple[int, ...]:
        return 1, self.view_size, self.view_size

    def reader(self, *, few: bool = False) -> Reader | None:
        square_alone = type(self) is Crop  # classes derived from it read more
        as_is = self.position_noise == 0 and self.cleaning.rules.memory is not Memory.PRIVATE
        return self.square if few and square_alone and as_is else None

    def square(self, state: State, rules: Rules) -> dict[NestedKey, Tensor]:
        """Return the squares around where robots are, nobody marked in them."""
        view = crop(state.record, state.position, state.step, self.view_size, rules)
        return {keys.OBSERVATION: view.unsqueeze(2)}

    def read(self, state: State) -> dict[NestedKey, Tensor]:
        centre = self.centre(state)
        view = self.compiled(crop, wide=True)(
            state.record, centre, state.step, self.view_size, self.cleaning.rules
        )
        view = self.with_contacts(view, centre, state)
        return {keys.OBSERVATION: view.unsqueeze(2)}

    def centre(self, state: State) -> Tensor:
        """Return where each robot thinks it is, the middle of what it sees."""
        if self.position_noise == 0:
            return state.position
        return self.compiled(believed_position)(
            state, self.env_index_of(state), self.cleaning.seed_word, self.position_noise
        )

    def with_contacts(self, view: Tensor, centre: Tensor, state: State) -> Tensor:
        """Show the robots in contact in views of private maps; shared and merged ones show them."""
        env = self.cleaning
        if env.rules.memory is not Memory.PRIVATE or env.contact is None:
            return view
        corner = centre - view.shape[-1] // 2
        contact = env.contact(state, env.rules)
        return self.compiled(mark_contacts)(view, corner, state.position, contact)
