"""Larger houses are admitted as the robots succeed in the smaller ones."""

from typing import Any

from jaxtyping import Bool
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.errors import BadInput


class Curriculum:
    """Opens the first of `stages` equal parts of an env's houses, then one more at each promotion.

    The houses stand in the order of their size. A stage is passed when, of the last
    `window_episodes` episodes that ended in it, a share of at least `promote_at` ended with every
    cell cleaned; the count begins anew in the next one. In stage k of s the first ceil(k / s N) of
    N houses are open. With one stage nothing is done to the env.

    Attributes:
        stage: the present one, from 1.
    """

    def __init__(self, stages: int, promote_at: float, window_episodes: int) -> None:
        self.stages, self.promote_at, self.window_episodes = stages, promote_at, window_episodes
        self.stage = 1
        self.recent: list[bool] = []  # of the window's episodes, whether each was finished

    def check(self, env: EnvBase) -> None:
        """Raise BadInput where there are fewer houses than stages."""
        if self.stages > 1 and self.stages > (count := len(env.houses)):
            raise BadInput(
                f"trainer.curriculum_stages={self.stages}: every stage needs a training house of"
                f" its own; valid: 1 to {count}"
            )

    def open_houses(self, env: EnvBase) -> None:
        """Let new episodes take place in the houses of the stages so far."""
        if (count := self.num_open(env)) is not None:
            env.open_houses(count)

    def num_open(self, env: EnvBase) -> int | None:
        """Return how many houses are open in this stage; None where all always are."""
        return -(-self.stage * len(env.houses) // self.stages) if self.stages > 1 else None

    def note(
        self, env: EnvBase, done: Bool[Tensor, "env time"], finished: Bool[Tensor, "env time"]
    ) -> None:
        """Count the episodes of a block, in the order in which they ended; promote if due."""
        if self.stage == self.stages:
            return
        ended = finished.mT[done.mT].tolist()
        self.recent = [*self.recent, *ended][-self.window_episodes :]
        full = len(self.recent) == self.window_episodes
        if full and sum(self.recent) >= self.promote_at * self.window_episodes:
            self.stage += 1
            self.recent = []
            self.open_houses(env)

    def measures(self) -> dict[str, int]:
        """Return what a row of metrics records of it."""
        return {"stage": self.stage} if self.stages > 1 else {}

    def state(self) -> dict[str, Any]:
        return {"stage": self.stage, "recent": self.recent}

    def restore(self, state: dict[str, Any]) -> None:
        self.stage, self.recent = state["stage"], state["recent"]
