"""`topology=view`: the paper's."""

from typing import final

from jaxtyping import Bool
from torch import Tensor

from marl_clean.settings import OddInt
from marl_clean.topology.base import Topology
from marl_clean.world.rules import Rules
from marl_clean.world.sensing import in_view
from marl_clean.world.state import State


@final
class View(Topology):
    """Robots talk while each stands inside the other's square view (paper §3.4).

    Args:
        view_size: side of the view in cells, odd.
    """

    def __init__(self, view_size: OddInt = 15) -> None:
        super().__init__()
        self.view_size = view_size

    def contact(self, state: State, rules: Rules) -> Bool[Tensor, "env agent agent"]:
        return in_view(state.position, self.view_size)
