"""What a `CleaningEnv` refuses: settings that do not fit each other, and wrong actions."""

import torch
from jaxtyping import Int
from torch import Tensor

from marl_clean.errors import BadInput
from marl_clean.settings import Knowledge, Memory
from marl_clean.world.dynamics import MOVES
from marl_clean.world.rules import Rules, knowledge_of_each
from marl_clean.world.setup import Contact, Telling


def check_rules(
    rules: Rules,
    n_agents: int,
    contact: Contact | None,
    exchange: Telling | None,
    furniture_moves_before_start: int,
) -> None:
    """Raises BadInput where the rules need what the other arguments do not give."""
    if rules.memory is not Memory.SHARED and contact is None:
        raise BadInput(f"env.memory={rules.memory}: needs contact=, a topology's contact function")
    if exchange is not None and rules.memory is not Memory.PRIVATE:
        raise BadInput(
            f"env.memory={rules.memory}: there is nothing to exchange or lend; valid: private"
        )
    knowledge_of_each(rules.knowledge, rules.memory, n_agents)
    if furniture_moves_before_start and Knowledge.STALE not in rules.kinds_of_knowledge:
        raise BadInput(
            f"env.furniture_moves_before_start={furniture_moves_before_start}: needs"
            f" env.knowledge=stale, not {', '.join(rules.kinds_of_knowledge)}; no robot remembers"
            " another house"
        )


def check_actions(action: Int[Tensor, "env agent"]) -> None:
    """Raises BadInput for an action outside MOVES; only on a CPU, where it costs no waiting."""
    if action.device.type != "cpu" or not action.numel():
        return
    lowest, highest = torch.aminmax(action)
    if lowest < 0 or highest >= len(MOVES):
        wrong = int(lowest if lowest < 0 else highest)
        raise BadInput(f"action {wrong}: valid: 0 up, 1 right, 2 down, 3 left")
