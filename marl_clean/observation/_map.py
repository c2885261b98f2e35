"""What the levels that show the map share: planes for its codes, and the robots in contact."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from marl_clean.settings import Memory
from marl_clean.world.rules import BLOCKED_VALUE, CLEANED_VALUE, ROBOT_VALUE, UNKNOWN_VALUE
from marl_clean.world.sensing import everyone, mark_contacts
from marl_clean.world.setup import Setup
from marl_clean.world.state import State


def spread_codes(
    observation: Float[Tensor, "*batch channel row col"],
) -> Float[Tensor, "*batch plane row col"]:
    """Spread the map's codes over four planes, so that no weight has to separate -0.2 from 0.2.

    The planes are blocked, unknown, dirt and robots: 1 where the code is this, else 0. Dirt is
    `1 - 2 v` of an available cell: 0 just cleaned, 1 dirty. The codes are constants, so comparing
    them exactly is right. Only the first channel is a map; others follow the planes unchanged.
    The result is laid out channels last.
    """
    code, further = observation[..., 0, :, :], observation[..., 1:, :, :]
    available = (code >= 0) & (code <= CLEANED_VALUE)
    out = code.new_empty(*code.shape, 4 + further.shape[-3])  # three times as fast as a stack
    out[..., 0] = code == BLOCKED_VALUE
    out[..., 1] = code == UNKNOWN_VALUE
    out[..., 2] = torch.where(available, 1 - code / CLEANED_VALUE, 0.0)
    out[..., 3] = code == ROBOT_VALUE
    out[..., 4:] = further.movedim(-3, -1)
    return out.movedim(-1, -3)


def with_contacts(
    view: Float[Tensor, "env agent row col"],
    corner: Int[Tensor, "env agent 2"],
    state: State,
    setup: Setup,
) -> Float[Tensor, "env agent row col"]:
    """Show the robots in contact in views of private maps; shared and merged maps show them.

    Without `robots_shown` no map shows a robot, and each view is given its own robot alone.
    `corner` is the place in the house that each view's first cell shows.
    """
    if not setup.rules.robots_shown:
        return mark_contacts(view, corner, state.position, ~everyone(state.position))
    if setup.rules.memory is not Memory.PRIVATE or setup.contact is None:
        return view
    return mark_contacts(view, corner, state.position, setup.contact(state, setup.rules))
