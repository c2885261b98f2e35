"""From an env to learning: blocks of frames, n-step windows, rows, the replay."""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs import MultiStepTransform
from torchrl.envs.utils import ExplorationType

from marl_clean import keys


class Windows(MultiStepTransform):
    """TorchRL's n-step windows over blocks of a collector, with the open ones as its state.

    Takes blocks `[env, time]` and gives those frames whose window is full, or ended by done:
    reward r_t + gamma r_t+1 + ..., `next` as it is at the window's end with its `terminated`,
    and the window's length under `steps_to_next_obs`.
    """

    def __init__(self, n_steps: int, gamma: float) -> None:
        # done_keys=[]: else an episode that ends in the window is bootstrapped past its end.
        super().__init__(n_steps, gamma, reward_keys=[keys.REWARD], done_keys=[])

    def state(self) -> TensorDict | None:
        return self._buffer

    def restore(self, state: TensorDict | None) -> None:
        self._buffer = state


class Rows:
    """Cuts what worlds step into rows of so many frames, one world's each.

    Attributes:
        open: the frames `[env, time]` that do not fill a row yet; None before the first.
    """

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self.open: TensorDictBase | None = None

    def full(self, block: TensorDictBase) -> Iterator[TensorDictBase]:
        """Add a block `[env, time]` and return the rows `[env, frames]` that are full now."""
        self.open = block if self.open is None else torch.cat([self.open, block], dim=1)
        while self.open.shape[1] >= self.frames:
            yield self.open[:, : self.frames].contiguous()
            self.open = self.open[:, self.frames :].contiguous()


def collector_settings(frames_per_batch: int) -> dict[str, Any]:
    """Return how every collector of a training collects."""
    return {
        "frames_per_batch": frames_per_batch,
        "total_frames": -1,
        "exploration_type": ExplorationType.RANDOM,
        "auto_register_policy_transforms": False,
    }


class CarriedCollector(Collector):
    """TorchRL's collector, with the step that it carries from block to block as its state."""

    def state(self) -> TensorDictBase:
        return self._carrier

    def restore(self, state: TensorDictBase) -> None:
        self._carrier.update(state)  # what states of earlier versions lack is as after a reset

    def begin_anew(self) -> None:
        """Leave the present episodes, and begin others."""
        self._carrier.update(self.env.reset())


def replay_state(replay: TensorDictReplayBuffer) -> dict[str, Any]:
    """Return what a replay buffer holds, and where it writes next."""
    frames = replay.storage[: len(replay)] if len(replay) else None
    return {"frames": frames, "writer": replay.writer.state_dict()}


def restore_replay(replay: TensorDictReplayBuffer, state: Mapping[str, Any]) -> None:
    """Fill an empty replay buffer, exactly as it was."""
    if state["frames"] is not None:
        replay.extend(state["frames"])
    replay.writer.load_state_dict(state["writer"])
