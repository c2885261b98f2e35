"""What collects the blocks of a training: the trainer, or processes of their own."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from marl_clean.trainer._collecting import CarriedCollector, collector_settings
from marl_clean.trainer._warm_start import WarmStart


@dataclass(frozen=True)
class Moment:
    """How far a training is when it asks for a block.

    Attributes:
        frames, total_frames: collected so far, and the run's length.
        finished: share of recent episodes that ended with every cell cleaned.
        num_open: houses from which new episodes draw theirs; None: all.
    """

    frames: int
    total_frames: int
    finished: float
    num_open: int | None


class Collecting(ABC):
    """Collects blocks of frames, and can be saved between two of them."""

    @abstractmethod
    def block(self, moment: Moment) -> TensorDictBase:
        """Collect the next block of frames `[env, time]`, with exploration."""

    @abstractmethod
    def progress(self) -> dict[str, float]:
        """Return measures of the worlds' present state, for the log."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Return what collecting resumes from."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`: exactly, or with new episodes where the env cannot be saved."""

    @abstractmethod
    def shutdown(self) -> None:
        """Let go of processes and of the env."""


class InTheTrainer(Collecting):
    """The trainer's own process steps all worlds."""

    def __init__(self, env: EnvBase, warm_start: WarmStart, frames_per_batch: int) -> None:
        self.env, self.warm_start = env, warm_start
        self.collector = CarriedCollector(
            env, warm_start.policy, track_traj_ids=False, **collector_settings(frames_per_batch)
        )
        self.blocks = iter(self.collector)

    def block(self, moment: Moment) -> TensorDictBase:
        self.warm_start.at(moment.frames)
        return next(self.blocks)

    def progress(self) -> dict[str, float]:
        return self.env.base_env.progress()

    def state(self) -> dict[str, Any]:
        return state_of(self.env, self.collector, self.warm_start)

    def restore(self, state: Mapping[str, Any]) -> None:
        restore_into(self.env, self.collector, self.warm_start, state)

    def shutdown(self) -> None:
        self.collector.shutdown(close_env=False)


def state_of(env: EnvBase, collector: CarriedCollector, warm_start: WarmStart) -> dict[str, Any]:
    """Return what one process's collecting resumes from."""
    return {
        "env": dict(env.base_env.state_dict()),
        "carried": collector.state(),
        "warm_start": warm_start.state(),
    }


def restore_into(
    env: EnvBase, collector: CarriedCollector, warm_start: WarmStart, state: Mapping[str, Any]
) -> None:
    """Go on from `state_of`; an env that cannot save its episodes begins new ones."""
    env.base_env.load_state_dict(state["env"])
    if env.base_env.resumes_exactly:
        collector.restore(state["carried"].to(env.device))
        warm_start.restore(state.get("warm_start", {}))
    else:
        collector.begin_anew()
