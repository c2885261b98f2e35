"""What the training loops share: their clock, log, best weights and states."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean import keys
from marl_clean.errors import BadInput
from marl_clean.learning.agent import Agent
from marl_clean.logger.base import CLOCK, Logger, Progress
from marl_clean.settings import Collectors, StatesOf
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._annealing import Annealing
from marl_clean.trainer._collectors import Moment
from marl_clean.trainer._curriculum import Curriculum
from marl_clean.trainer._finite import check_learner, check_numbers
from marl_clean.trainer._first_updates import FirstUpdates
from marl_clean.trainer._frames import IN_THE_TRAINER, check_frames
from marl_clean.trainer._interrupts import Interrupts, Stopped
from marl_clean.trainer._loggers import Loggers
from marl_clean.trainer._outcome import Outcome, earlier_outcome
from marl_clean.trainer._owed import Learning, Owed
from marl_clean.trainer._random import random_state, restore_random
from marl_clean.trainer._remote import make_collecting
from marl_clean.trainer._selection import Best
from marl_clean.trainer._share import MakeShare
from marl_clean.trainer._tally import Tally

Evaluate = Callable[[TensorDictModuleBase], Mapping[str, float]]
log = logging.getLogger(__name__)
COUNTERS = ("frames", "updates", "logged", "evaluated", "saved")


class Trainer(ABC):
    """Train an agent in a budget of frames.

    Every block of frames: collect with exploration, and learn. At fixed frames: log, evaluate and
    keep the best weights, save the state. The same call resumes exactly from the newest state, on a
    CPU with one thread; only an env that cannot be saved in the middle of its episodes begins anew.
    """

    total_frames: int
    frames_per_batch: int
    log_interval_frames: int
    eval_interval_frames: int
    checkpoint_interval_frames: int
    select_by: str
    curriculum: tuple[int, float, int]
    imitate: str | None = None
    imitate_frames_share: float = 0.0
    imitate_states: StatesOf = "planner"
    collectors: Collectors = IN_THE_TRAINER

    @abstractmethod
    def begin(
        self,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: list[Logger],
        checkpoints: Checkpoints,
        make_share: MakeShare | None = None,
    ) -> "TrainingLoop":
        """Return the live parts of a training that has no frames yet."""

    @abstractmethod
    def longest_row(self, env: EnvBase) -> tuple[str, int]:
        """Return how many frames of one world are learnt from in a row, and the setting's name."""

    def check(self, env: EnvBase, agent: Agent) -> None:
        """Raise BadInput where a setting does not fit the env or the agent."""
        key, row = self.longest_row(env)
        if agent.history >= row:
            raise BadInput(
                f"trainer.{key}: {row} frames in a row, but what is learnt goes {agent.history}"
                f" steps back (memory, delayed messages); at least {agent.history + 1} are valid"
            )
        check_frames(vars(self), env.batch_size.numel())
        Curriculum(*self.curriculum).check(env.base_env)

    def train(
        self,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: Iterable[Logger],
        folder: Path,
        start_is_candidate: bool = False,
        make_share: MakeShare | None = None,
        first_updates: FirstUpdates | None = None,
    ) -> Outcome:
        """Train `agent` in `env` until the budget is spent; resume what `folder` holds.

        `evaluate` measures a policy on validation houses, by name; with `start_is_candidate` the
        weights that came with the agent may be best. `make_share`: what `collectors` make;
        `first_updates`: what notes these, by default in the folder.

        Raises:
            BadInput: a setting that does not fit the env, damaged checkpoints, a full disk.
            Diverged: a number became NaN or infinite; nothing of it was saved.
            SystemExit: 143 or 130, after SIGTERM or SIGINT, when the state is saved.
        """
        checkpoints = Checkpoints(folder / FOLDER)
        if (outcome := earlier_outcome(checkpoints)) is not None:
            return outcome
        self.check(env, agent)
        loop = self.begin(env, agent, evaluate, list(loggers), checkpoints, make_share)
        first = first_updates or FirstUpdates(folder)
        try:
            loop.resume()
            first.resume(loop.frames, loop.updates)
            with loop.interrupts, Progress(self.total_frames, loop.frames) as progress:
                if start_is_candidate and not loop.frames:
                    with suppress(Stopped):  # the loop sees the signal
                        loop.measure()
                while True:
                    loop.report(progress)
                    signal = loop.interrupts.signal  # one that comes from here on waits its turn
                    if signal or loop.due(self.checkpoint_interval_frames, loop.saved):
                        loop.save()
                    if signal:
                        raise SystemExit(128 + signal)
                    if loop.frames >= self.total_frames and loop.owed is None:
                        return loop.finish()
                    loop.advance(first)
        finally:
            loop.close()


class TrainingLoop(Learning):
    """The live parts of one training, and how far it is."""

    def __init__(
        self,
        settings: Trainer,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: list[Logger],
        checkpoints: Checkpoints,
        make_share: MakeShare | None = None,
    ) -> None:
        self.settings, self.env, self.agent, self.evaluate = settings, env, agent, evaluate
        self.loggers, self.checkpoints = Loggers(loggers), checkpoints
        self.curriculum = Curriculum(*settings.curriculum)
        self.curriculum.open_houses(env.base_env)
        shown = settings.imitate_frames_share * settings.total_frames
        imitate = settings.imitate, shown, settings.imitate_states
        opened, block = self.curriculum.num_open(env.base_env), settings.frames_per_batch
        self.collectors = make_collecting(
            env, agent, make_share, imitate, opened, settings.collectors, block
        )
        self.annealing, self.tally, self.interrupts = Annealing(), Tally(), Interrupts()
        self.frames = self.updates = 0
        self.logged = self.evaluated = self.saved = 0  # frames at the last time
        self.best = Best(settings.select_by, checkpoints)

    def collect(self) -> TensorDictBase:
        """Collect a block of frames `[env, time]` with exploration, and update the tally."""
        num_open = self.curriculum.num_open(self.env.base_env)
        moment = Moment(self.frames, self.settings.total_frames, self.annealing.share, num_open)
        block = self.collectors.block(moment)
        self.frames += block.numel()
        check_numbers(block, self.frames)
        later = block["next"]
        done, finished = (later[key].squeeze(-1) for key in (keys.DONE, keys.TERMINATED))
        self.tally.add("reward", later[keys.REWARD])
        for key in (keys.INFO_COLLISION, keys.INFO_SHAPING, keys.INFO_SPILL):
            if (term := later.get(key, None)) is not None:
                self.tally.add(key[-1], term)
        self.tally.add("episode_reward", later[keys.EPISODE_REWARD].mean((-2, -1)), where=done)
        self.tally.add("finished", finished.double(), where=done)
        self.curriculum.note(self.env.base_env, done, finished)
        self.annealing.note(done, finished)
        self.annealing.set(self.agent, self.env, self.frames / self.settings.total_frames)
        return block

    @abstractmethod
    def own_state(self) -> dict[str, Any]:
        """Return what this loop resumes from beside what all have."""

    @abstractmethod
    def restore_own(self, state: Mapping[str, Any]) -> None:
        """Go on from `own_state`."""

    def report(self, progress: Progress) -> None:
        """Evaluate and write a row, each if it is due; show how far the run is."""
        if self.owed is not None:  # in the middle of a block
            return
        row: dict[str, float] = {}
        ended = self.frames >= self.settings.total_frames and self.evaluated < self.frames
        if ended or self.due(self.settings.eval_interval_frames, self.evaluated):
            try:
                row = self.measure()
            except Stopped:  # done anew when the run is resumed
                return
        if row or self.due(self.settings.log_interval_frames, self.logged):
            row |= self.tally.means() | {
                "updates": self.updates,
                **self.agent.measures(),
                **self.collectors.progress(),
                **self.curriculum.measures(),
                f"{CLOCK}frames_per_second": progress.frames_per_second(self.frames),
            }
            check_numbers(row, self.frames)
            self.loggers.log(self.frames, row)
            self.logged = self.frames
        progress.show(self.frames, row)

    def measure(self) -> dict[str, float]:
        """Measure the greedy policy on validation houses; keep its weights if they are best."""
        cuda = [self.env.device] if self.env.device.type == "cuda" else []
        with torch.random.fork_rng(devices=cuda), torch.no_grad(), self.interrupts.breakable():
            measured = self.evaluate(self.agent.policy())
        check_numbers({"validation": measured}, self.frames)
        self.best.offer(self.frames, measured, self._weights())
        self.evaluated = self.frames
        return {f"validation/{name}": value for name, value in measured.items()}

    def _weights(self) -> dict[str, Tensor]:
        """Return a copy of the network's weights. Raises Diverged where the learner diverged."""
        check_learner(self.agent, self.updates, self.frames)
        return {name: w.clone() for name, w in self.agent.network.state_dict().items()}

    def due(self, interval: int, last: int) -> bool:
        """Tell whether `interval` frames have been played since `last`."""
        return self.frames - last >= interval

    def save(self) -> None:
        """Save everything that the run resumes from. Raises Diverged where it is not finite."""
        self.saved = self.frames
        state = {
            "counters": {name: getattr(self, name) for name in COUNTERS},
            "best": self.best.record,
            "agent": self.agent.state_dict(),
            **self.collectors.state(),
            **self.own_state(),
            "owed": None if self.owed is None else vars(self.owed),
            "tally": self.tally.state(),
            "curriculum": self.curriculum.state(),
            "annealing": {"share": self.annealing.share},
            "loggers": self.loggers.state(),
            "random": random_state(self.env.device),
        }
        self.checkpoints.save("state", self.frames, state, {})

    def resume(self) -> None:
        """Resume from the newest state, if there is one."""
        newest = self.checkpoints.newest("state")
        state = {} if newest is None else newest.tree
        if state:
            self._restore(state)
            self.checkpoints.forget_after(self.frames)
            self.best.save()
        self.annealing.set(self.agent, self.env, self.frames / self.settings.total_frames)
        self.loggers.resume(self.logged, state.get("loggers", {}))  # earlier versions saved none

    def _restore(self, state: dict[str, Any]) -> None:
        for name in COUNTERS:
            setattr(self, name, state["counters"][name])
        self.best.record = state["best"]
        self.agent.load_state_dict(state["agent"])
        self.collectors.restore(state)
        if not self.env.base_env.resumes_exactly:
            log.warning("frame %d: resumes with new episodes; env cannot save its own", self.frames)
        self.restore_own(state)
        if (owed := state.get("owed")) is not None:
            self.owed = Owed.of(owed, self.env.device)
        self.tally.restore(state["tally"])
        self.curriculum.restore(state["curriculum"])
        self.curriculum.open_houses(self.env.base_env)
        self.annealing.share = state.get("annealing", {"share": 0.0})["share"]
        restore_random(state["random"], self.env.device)

    def finish(self) -> Outcome:
        """Write the last rows, save the last weights; the states are then of no more use."""
        self.loggers.close()
        notes = {"updates": self.updates, "best": self.best.summary()}
        self.checkpoints.save("final", self.frames, self._weights(), notes)
        self.checkpoints.remove("state")
        return Outcome(self.frames, self.updates, self.best.summary(), was_finished=False)

    def close(self) -> None:
        """Let go of the collectors, and put all rows on the disk."""
        self.collectors.shutdown()
        self.loggers.close()
