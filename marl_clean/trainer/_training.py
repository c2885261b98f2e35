"""What training loops need beside their algorithms: to be stopped, and to go on exactly."""

import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs import MultiStepTransform

from marl_clean import keys
from marl_clean.errors import BadInput
from marl_clean.storage.checkpoint import Checkpoints


class Diverged(BadInput):
    """A number that learning needs is NaN or infinite; the message names it, and the update."""


class Stopped(Exception):
    """A signal came while something ran that may be broken off."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        frames, updates: played and learnt in all.
        best: frames and measures of the weights chosen on validation houses; None without any.
        was_finished: nothing was left to do.
    """

    frames: int
    updates: int
    best: dict[str, Any] | None
    was_finished: bool


class Interrupts:
    """Turns SIGTERM and SIGINT into a flag, to be acted on where the run can be saved.

    Attributes:
        signal: the signal that came, or None.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._breakable = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interrupts":
        if threading.current_thread() is threading.main_thread():  # others cannot have handlers
            for number in (signal.SIGTERM, signal.SIGINT):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Let a signal break off what runs inside, by Stopped; outside it only sets the flag."""
        self._breakable = True
        try:
            if self.signal is not None:
                raise Stopped
            yield
        finally:
            self._breakable = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        if self._breakable:
            self._breakable = False
            raise Stopped


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
    """Cuts what worlds play into rows of so many frames, one world's each.

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


class CarriedCollector(Collector):
    """TorchRL's collector, with the step that it carries from block to block as its state."""

    def state(self) -> TensorDictBase:
        return self._carrier

    def restore(self, state: TensorDictBase) -> None:
        self._carrier = state

    def begin_anew(self) -> None:
        """Leave the episodes that are being played, and begin others."""
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


def random_state(device: torch.device) -> dict[str, Tensor]:
    """Return the states of torch's random streams, the CPU's and that of `device`."""
    states = {"cpu": torch.get_rng_state()}
    if device.type == "cuda":
        states["cuda"] = torch.cuda.get_rng_state(device)
    return states


def restore_random(states: Mapping[str, Tensor], device: torch.device) -> None:
    """Put torch's random streams where `random_state` was taken."""
    torch.set_rng_state(states["cpu"])
    if device.type == "cuda":
        torch.cuda.set_rng_state(states["cuda"], device)


def check_finite(values: Tensor, name: str, updates: int, frames: int) -> None:
    """Raise Diverged where one of the values, measured after `updates` updates, is not finite."""
    if not values.isfinite().all():
        update = updates + 1 + int(values.isfinite().logical_not().nonzero()[0])
        raise Diverged(
            f"update {update}, frame {frames}: {name} is NaN or infinite;"
            " nothing of it is saved; a smaller agent.lr may help"
        )


class Best:
    """The weights that a measure on validation houses chose so far, saved as they are chosen.

    Attributes:
        by: the measure; of times (T_...) the lowest is best, of all others the highest.
        found: frames, measured and weights of the best; None before the first evaluation.
    """

    def __init__(self, by: str, checkpoints: Checkpoints) -> None:
        self.by, self.checkpoints = by, checkpoints
        self.sign = -1.0 if by.startswith("T_") else 1.0
        self.found: dict[str, Any] | None = None

    def offer(self, frames: int, measured: Mapping[str, float], weights: dict[str, Tensor]) -> None:
        """Keep and save the weights if they are better than all before."""
        if self.by not in measured:
            raise BadInput(f"trainer.select_by={self.by}: valid: {', '.join(sorted(measured))}")
        value = self.sign * measured[self.by]
        if self.found is None or value > self.sign * self.found["measured"][self.by]:
            self.found = {"frames": frames, "measured": dict(measured), "weights": weights}
            self.save()

    def save(self) -> None:
        """Save the best again, where a run that goes on does not find it."""
        if self.found is not None:
            frames, measured = self.found["frames"], self.found["measured"]
            self.checkpoints.save("best", frames, self.found["weights"], measured)

    def summary(self) -> dict[str, Any] | None:
        """Return frames and measures of the best, without its weights."""
        if self.found is None:
            return None
        return {"frames": self.found["frames"], **self.found["measured"]}


class Tally:
    """Sums of measures and how often each was taken, kept as tensors until a row is due."""

    def __init__(self) -> None:
        self.sums: dict[str, Tensor] = {}
        self.counts: dict[str, Tensor] = {}

    def add(self, name: str, values: Tensor, where: Tensor | None = None) -> None:
        """Take all `values`, or those that a mask of the same shape picks."""
        chosen = torch.ones_like(values, dtype=torch.bool) if where is None else where
        total = torch.where(chosen, values, 0).sum(dtype=torch.float64)
        self.sums[name] = self.sums.get(name, 0) + total
        self.counts[name] = self.counts.get(name, 0) + chosen.sum()

    def means(self) -> dict[str, float]:
        """Return the mean of each measure that was taken at all, and begin anew."""
        counts = {name: int(count) for name, count in self.counts.items()}
        means = {name: float(self.sums[name]) / count for name, count in counts.items() if count}
        self.sums, self.counts = {}, {}
        return means

    def state(self) -> dict[str, dict[str, Tensor]]:
        return {"sums": self.sums, "counts": self.counts}

    def restore(self, state: Mapping[str, dict[str, Tensor]]) -> None:
        self.sums, self.counts = state["sums"], state["counts"]
