"""The updates that are owed for a block of frames, which a signal may break off between two."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from marl_clean.learning.agent import Agent
from marl_clean.trainer._finite import check_learner
from marl_clean.trainer._first_updates import FirstUpdates
from marl_clean.trainer._interrupts import Interrupts
from marl_clean.trainer._tally import Tally


@dataclass
class Owed:
    """Updates that are left to be made, and what those before them measured.

    Attributes:
        num: how many are left.
        items: on policy, what is learnt from.
        order: of the items, those that are left of an epoch; none at its beginning.
        measured: of each update that was made.
    """

    num: int
    items: TensorDictBase | None = None
    order: Tensor | None = None
    measured: list[dict[str, Tensor]] = field(default_factory=list)

    @classmethod
    def of(cls, state: Mapping[str, Any], device: torch.device) -> "Owed":
        """Return those of a saved state."""
        items, order = (
            None if state[key] is None else state[key].to(device) for key in ("items", "order")
        )
        measured = [{name: v.to(device) for name, v in each.items()} for each in state["measured"]]
        return cls(state["num"], items, order, measured)


class Learning(ABC):
    """What a training loop does with a block, until a signal comes."""

    agent: Agent
    tally: Tally
    interrupts: Interrupts
    frames: int
    updates: int
    owed: Owed | None = None

    @abstractmethod
    def collect(self) -> TensorDictBase:
        """Collect a block of frames."""

    @abstractmethod
    def learn(self, block: TensorDictBase) -> None:
        """Learn from a block, or from what is remembered of it and of those before."""

    @abstractmethod
    def update(self, owed: Owed) -> dict[str, Tensor]:
        """Make the next update; return what it measured."""

    def advance(self, first: FirstUpdates) -> None:
        """Collect a block and learn from it, or go on with one that a signal broke off."""
        if self.owed is None:
            self.learn(self.collect())
        else:
            self.make(self.owed)
        if self.owed is None:
            first.note(self.frames, self.updates, self.agent.network)

    def make(self, owed: Owed) -> None:
        """Make the updates that are owed; those that a signal leaves stay owed."""
        self.owed = owed
        while owed.num:
            if self.interrupts.signal is not None:
                return
            owed.measured.append(self.update(owed))
            owed.num -= 1
        self.owed = None
        self.count(owed.measured)

    def count(self, measured: list[dict[str, Tensor]]) -> None:
        """Count updates by what they measured. Raises Diverged where a number is not finite."""
        measures = {name: torch.stack([each[name] for each in measured]) for name in measured[0]}
        check_learner(self.agent, self.updates, self.frames, measures)
        for name, values in measures.items():
            self.tally.add(name, values)
        self.updates += len(measured)
