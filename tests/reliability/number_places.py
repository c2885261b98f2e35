"""The places of a training in which `tests.reliability.numbers` plants NaN and infinity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from marl_clean import keys
from marl_clean.learning.agent import Agent
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.ppo import Ppo
from marl_clean.trainer.base import TrainingLoop


@dataclass
class Run:
    """A training in progress, and what is planted in it."""

    loop: TrainingLoop
    value: float

    @property
    def agent(self) -> Any:
        return self.loop.agent

    def spoil(self, tensor: Tensor) -> None:
        """Write the number into a tensor in place."""
        with torch.no_grad():
            tensor[(0,) * tensor.ndim] = self.value

    def spoil_block(self, *key: Any) -> None:
        """Let the next blocks hold the number."""
        collect = self.loop.collectors.block

        def block(moment: Any) -> Any:
            frames = collect(moment)
            self.spoil(frames[key])
            return frames

        self.loop.collectors.block = block  # type: ignore[method-assign]

    def spoil_loss(self) -> None:
        """Let the losses of the next updates be the number; gradients stay as they are."""
        if isinstance(self.agent, Ppo):
            forward = self.agent._loss.forward

            def losses(batch: Any) -> Any:
                made = forward(batch)
                return made.set("loss_objective", made["loss_objective"] + self.value)

            self.agent._loss.forward = losses
            return
        loss = self.agent.loss
        self.agent.loss = lambda frames: loss(frames) + self.value

    def spoil_messages(self) -> None:
        """Let messages arrive as the number."""
        channel = self.agent.network.stack[0]
        carry = channel.carry

        def carried(*arguments: Any) -> tuple[Tensor, Tensor]:
            message, edges = carry(*arguments)
            return message + self.value, torch.ones_like(edges)

        channel.carry = carried

    def spoil_moment(self, name: str) -> None:
        self.spoil(self.agent._optimiser.state[self.agent._parameters[0]][name])


@dataclass(frozen=True)
class Place:
    """Where a number is planted.

    Attributes:
        plant: plants it.
        events: of the loop, before which it is planted.
        named: what the line may name, as a regular expression.
        since: the block since which there is such a place; in replay it takes two to fill a row.
        in_learner: which learners have it.
        read_by_saves: nothing else need read it.
    """

    plant: Callable[[Run], object]
    events: Sequence[str]
    named: str = ".+"
    since: int = 2
    in_learner: Callable[[Any], object] = lambda agent: True
    read_by_saves: bool = False

    def counts(self, event: str, blocks: int) -> range:
        """Return before the how manieth of these events it can be planted."""
        after = event == "measure"  # each block
        return range(max(1, self.since - after), blocks + 1)


def carried_in(run: Run) -> Any:
    return run.loop.collectors.collector._carrier  # type: ignore[attr-defined]


def carries(agent: Agent) -> bool:
    return agent.unrolls


BEFORE = ("collect", "learn", "measure")
PLACES = {
    "a reward": Place(lambda run: run.spoil_block("next", keys.REWARD), ["collect"], "a reward", 1),
    "an observation": Place(
        lambda run: run.spoil_block("next", keys.OBSERVATION), ["collect"], ".*observation", 1
    ),
    "the loss": Place(Run.spoil_loss, ["learn"], "loss", 1),
    "a gradient": Place(
        lambda run: run.agent._parameters[0].register_hook(lambda grad: grad + run.value),
        ["learn"],
        "grad_norm|loss|weight .*",
        1,
    ),
    "a weight": Place(lambda run: run.spoil([*run.agent.network.parameters()][-1]), BEFORE),
    "a first moment": Place(lambda run: run.spoil_moment("exp_avg"), BEFORE, since=3),
    "a second moment": Place(
        lambda run: run.spoil_moment("exp_avg_sq"), BEFORE, ".*exp_avg_sq|loss|weight .*", 3
    ),
    "a target's weight": Place(
        lambda run: run.spoil(run.agent._followers[-1]),
        BEFORE,
        in_learner=lambda agent: isinstance(agent, DeepQ),
    ),
    "a mixer's weight": Place(
        lambda run: run.spoil([*run.agent._beside_network()[0].parameters()][-1]),
        BEFORE,
        in_learner=lambda agent: "Qmix" in type(agent).__name__,
    ),
    "a critic's weight": Place(
        lambda run: run.spoil([*run.agent.critic.parameters()][-1]),
        BEFORE,
        in_learner=lambda agent: isinstance(agent, Ppo),
    ),
    "a critic's memory": Place(
        lambda run: run.spoil(run.agent._critic_hidden),
        ["learn", "measure"],
        in_learner=lambda agent: isinstance(agent, Ppo),
    ),
    "memory": Place(
        lambda run: run.spoil(carried_in(run)[keys.HIDDEN]), ["collect"], in_learner=carries
    ),
    "messages under way": Place(
        lambda run: run.spoil(carried_in(run)[keys.INBOX]), ["collect"], in_learner=carries
    ),
    "a message": Place(Run.spoil_messages, ["collect", "learn"], in_learner=carries),
    "the replay": Place(
        lambda run: run.spoil(run.loop.replay.storage._storage["next", keys.REWARD]),  # type: ignore[attr-defined]
        ["collect"],
        since=3,
        in_learner=lambda agent: isinstance(agent, DeepQ),
        read_by_saves=True,
    ),
    "a validation measure": Place(
        lambda run: setattr(run.loop, "evaluate", lambda policy: {"return": run.value}),
        ["measure"],
        "validation/return",
        1,
    ),
}
