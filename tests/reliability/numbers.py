"""NaN and infinity planted in tiny trainings: `python -m tests.reliability.numbers --trials 500`.

A trial plants a number in one place (a reward, a loss, a gradient, a weight, a moment of the
optimiser, what is carried, a message, ...) of one learner's training at one moment. It must end
with Diverged, in one line that names the frame and the tensor, and no file of the run may hold a
number that is not finite. Without `--trials` all of them run.
"""

import argparse
import json
import logging
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import torch
from safetensors.torch import load_file
from torch import Tensor
from torchrl.data import Binary
from torchrl.envs import Compose, TransformedEnv

from marl_clean import build, keys
from marl_clean.channel.delayed import Delayed
from marl_clean.learning.agent import Agent
from marl_clean.logger.csv import Csv
from marl_clean.storage.finite import Diverged
from marl_clean.trainer.base import Trainer, TrainingLoop
from marl_clean.trainer.off_policy import OffPolicy
from marl_clean.trainer.on_policy import OnPolicy
from tests.agent.parts import LEARNERS, STATE_SHAPE, make_comm, make_encoder, make_learner
from tests.reliability.number_places import PLACES, Run
from tests.trainer.probe import N_AGENTS, Probe

BLOCK, BLOCKS, WORLDS = 24, 3, 8
SHARED = {
    "total_frames": BLOCK * BLOCKS,
    "frames_per_batch": BLOCK,
    "log_interval_frames": BLOCK,
    "eval_interval_frames": BLOCK,
    "select_by": "return",
}
REPLAY = {
    "buffer_frames": 10 * BLOCK,
    "batch_frames": BLOCK,
    "replay_ratio": 2.0,
    "start_frames": 0,
    "window_frames": 3,
}
EPOCHS = {"epochs": 2, "minibatch_frames": BLOCK}
SAVED_EVERY = {"each block": BLOCK, "the end": 10 * BLOCK}
VALUES = (torch.nan, torch.inf, -torch.inf)
LINE = re.compile(r"(update \d+, )?frame (\d+): (.+) is NaN or infinite; .*saved.*")


class StatefulProbe(Probe):
    """The probe with a true state, which mixers need."""

    def __init__(self) -> None:
        super().__init__(WORLDS)
        shape = torch.Size([WORLDS, *STATE_SHAPE])
        self.observation_spec[keys.STATE] = Binary(shape=shape, dtype=torch.bool)

    def _answer(self, agents: dict, done: Tensor, even: Tensor) -> Any:
        state = (self.code > 1).view(WORLDS, 1, 1, N_AGENTS)
        return super()._answer(agents, done, even).set(keys.STATE, state)


@dataclass(frozen=True)
class Trial:
    """A number planted in a place of a learner before the `count`-th of its loop's events."""

    learner: str
    place: str
    event: str
    count: int
    saved: str
    value: float


def all_trials() -> list[Trial]:
    """Every trial that makes sense: before the first update an optimiser has no moments."""
    agents = {learner: make_agent(learner) for learner in LEARNERS}
    trials = []
    for learner, (name, place), saved, value in product(
        LEARNERS, PLACES.items(), SAVED_EVERY, VALUES
    ):
        if not place.in_learner(agents[learner]) or (place.read_by_saves and saved == "the end"):
            continue
        for event in place.events:
            counts = place.counts(event, BLOCKS)
            trials += [Trial(learner, name, event, count, saved, value) for count in counts]
    return trials


def make_agent(level: str) -> Agent:
    """A learner that remembers and hears late, where it can."""
    if level == "central_dqn":
        return make_learner(level, "none")
    encoder = make_encoder(memory="gru")
    dims = tuple(make_comm("plan", encoder).message_dims)
    changes: dict[str, Any] = {"encoder": encoder, "channels": {"delayed": Delayed(1, False, dims)}}
    if level in ("ippo", "mappo"):
        changes["critic_memory"] = "gru"
    return make_learner(level, "plan", **changes)


def make_trainer(agent: Agent, saved: str) -> Trainer:
    shared = {**SHARED, "checkpoint_interval_frames": SAVED_EVERY[saved]}
    if agent.fits["trainer"] == ["off_policy"]:  # type: ignore[attr-defined]
        return OffPolicy(**shared, **REPLAY)
    return OnPolicy(**shared, **EPOCHS)


def train(trial: Trial, folder: Path) -> TrainingLoop:
    """Train with the number planted at its moment; return the loop, as far as it came."""
    torch.manual_seed(0)
    agent = make_agent(trial.learner)
    trainer, env = make_trainer(agent, trial.saved), TransformedEnv(StatefulProbe(), Compose())
    begun: list[TrainingLoop] = []
    begin, seen = trainer.begin, 0

    def with_plant(*arguments: Any) -> TrainingLoop:
        loop = begin(*arguments)
        begun.append(loop)
        original = getattr(loop, trial.event)

        def event(*given: Any) -> Any:
            nonlocal seen
            seen += 1
            if seen == trial.count:
                PLACES[trial.place].plant(Run(loop, trial.value))
            return original(*given)

        setattr(loop, trial.event, event)
        return loop

    trainer.begin = with_plant  # type: ignore[method-assign]
    ready = build.ready_for(agent, env)
    try:
        trainer.train(ready, agent, lambda policy: {"return": 0.5}, [Csv(folder)], folder)
    except Diverged as error:
        check_line(str(error), trial, begun[0].frames)
    else:
        raise AssertionError("went unnoticed")
    return begun[0]


def check_line(line: str, trial: Trial, frames: int) -> None:
    """The line names the frame, and a tensor of those that the place allows."""
    match = LINE.fullmatch(line)
    assert match is not None, f"says {line!r}"
    assert int(match[2]) == frames, f"says {line!r} at frame {frames}"
    assert re.fullmatch(PLACES[trial.place].named, match[3]), f"names {match[3]}"


def check_files(folder: Path) -> int:
    """No file holds a number that is not finite; return how many were read."""

    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{path} holds {constant}")

    read = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    for path in read:
        if path.suffix == ".safetensors":
            for name, tensor in load_file(path).items():
                assert not tensor.is_floating_point() or tensor.isfinite().all(), f"{path}: {name}"
        elif path.suffix == ".json":
            json.loads(path.read_text(), parse_constant=refuse)
        else:
            assert not re.search(r"\b(nan|inf)\b", path.read_text()), path
    return len(read)


def failures(trials: Sequence[Trial]) -> list[str]:
    """Run trials; return a line for each that broke the promise."""
    failed = []
    for trial in trials:
        with tempfile.TemporaryDirectory() as place:
            try:
                train(trial, Path(place))
            except Exception as error:  # whatever else a training raises is a broken promise
                failed.append(f"{trial}: {type(error).__name__}: {error}")
            try:
                check_files(Path(place))
            except AssertionError as error:
                failed.append(f"{trial}: {error}")
    return failed


def drawn(count: int | None, seed: int = 0) -> list[Trial]:
    """So many of all trials, drawn, one of each place before a second of any; all without one."""
    trials = all_trials()
    random.Random(seed).shuffle(trials)
    before: Counter[str] = Counter()
    turns = []
    for trial in trials:
        turns.append((before[trial.place], trial))
        before[trial.place] += 1
    return [trial for _, trial in sorted(turns, key=lambda turn: turn[0])][:count]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=None)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports every buffer it makes
    trials = drawn(arguments.trials, arguments.seed)
    began = time.monotonic()
    failed = failures(trials)
    sys.stdout.write("".join(f"{line}\n" for line in failed))
    sys.stdout.write(
        f"numbers: {len(trials)} trials ({len({t.learner for t in trials})} learners,"
        f" {len({t.place for t in trials})} places): {len(failed)} broke the promise;"
        f" {time.monotonic() - began:.0f} s\n"
    )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
