"""A training under fire: `python -m tests.reliability.kills --trials 1000`.

A tiny training is killed with SIGKILL at a random moment and goes on in a new process, until that
is killed too; after a few kills it may end. Then every file of the run must be what it is without
a kill: weights, rows, first updates, and nothing more. The processes are forks of this one, in
which everything is imported: a kill costs less than a second.

Moments are spread over the whole training by its time, and a share of them (`AT_SAVES`) is where
checkpoints are written or removed.
"""

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import torch

from marl_clean.config.compose import compose_config
from marl_clean.storage import manifest
from tests.reliability.forks import PHASES, REMOVE, SAVE, Broken, Fork, Moment, train

TINY = [
    *("env.num_envs=2", "house.rows=[4,5]", "house.cols=[4,6]", "train_houses=4"),
    *("env.max_steps=5", "evaluation.houses=1", "evaluation.plans=[]", "logger=[csv,tensorboard]"),
    *("observation.view_size=5", "encoder.channels=[2]", "encoder.strides=[2]"),
    *("encoder.hidden=[4]", "comm.message_dim=3", "trainer.total_frames=48"),
    *("trainer.frames_per_batch=8", "trainer.log_interval_frames=8"),
    *("trainer.eval_interval_frames=24", "trainer.checkpoint_interval_frames=8"),
]
OFF_POLICY = [
    *("trainer.buffer_frames=32", "trainer.batch_frames=8", "trainer.replay_ratio=1"),
    *("trainer.start_frames=8", "agent.eps_end=0.5"),
]
ON_POLICY = ["trainer=on_policy", "trainer.epochs=2", "trainer.minibatch_frames=4"]
IN_ROWS = [*OFF_POLICY, "trainer.window_frames=4"]
KINDS = {
    "iql": OFF_POLICY,
    "pqn": ["agent=pqn", "agent.eps_end=0.5", *ON_POLICY],
    "ippo": ["agent=ippo", *ON_POLICY],
    "qmix": ["agent=qmix", "reward=team", *OFF_POLICY],
    "memory": ["encoder.memory=gru", *IN_ROWS],
    "delayed": ["channel=[delayed,lossy]", *IN_ROWS],
    "curriculum": [
        *("trainer.curriculum_stages=3", "trainer.curriculum_promote_at=0"),
        *("trainer.curriculum_window_episodes=3", *OFF_POLICY),
    ],
    "furniture": ["env.furniture_moves_per_episode=2", "env.spills.per_episode=1", *OFF_POLICY],
    "private": ["env.memory=private", *OFF_POLICY],
    "merged": ["env.memory=merged", *OFF_POLICY],
}
AT_SAVES = 0.5
STARTING = 2  # letters of every process: it begins, and resumes
MOST_KILLS = 8  # of one run
INSTANT_SECONDS = 1e-4  # so that what is over at once is hit too


@dataclass
class Seen:
    """What was seen in all runs; `kills` by the letter of what was going on."""

    runs: int = 0
    kills: Counter[str] = field(default_factory=Counter)

    @property
    def in_saves(self) -> int:
        return self.kills[SAVE] + self.kills[REMOVE]

    def __str__(self) -> str:
        total = self.kills.total()
        listed = ", ".join(f"{PHASES[letter]} {n}" for letter, n in self.kills.most_common())
        return (
            f"{total} kills in {self.runs} runs, {self.in_saves} of them inside a save ({listed}):"
            " 0 lost runs, 0 unreadable checkpoints, 0 files that differ"
        )


class Training:
    """One kind of training, and what it leaves when nothing kills it."""

    def __init__(self, kind: str, place: Path) -> None:
        assert torch.get_num_threads() == 1, "forks of a process with more would wait for them"
        self.kind, self.place = kind, place / kind
        self.place.mkdir()
        self.config = compose_config([*TINY, *KINDS[kind], "name=run"])
        train(self.config, self.place / "first")  # in this process: forks need not import anything
        self.parts = Fork(self.config, self.place / "whole").parts
        self.whole = contents(self.place / "whole")
        self.compare(self.place / "first")

    def fire_at(self, draw: random.Random, kills: int, seen: Seen) -> None:
        """Kill one run up to `kills` times, let it end, and compare."""
        folder = Path(tempfile.mkdtemp(dir=self.place))
        for _ in range(kills):
            fork = Fork(self.config, folder, self.moment(draw, folder))
            self.check_whole(folder)
            if not fork.killed:
                break
            seen.kills[fork.parts[-1][0]] += 1
        else:
            Fork(self.config, folder)
        self.compare(folder)
        shutil.rmtree(folder)
        seen.runs += 1

    def moment(self, draw: random.Random, folder: Path) -> Moment:
        """Draw a moment of what is left of the run, as far as the newest state tells."""
        states = manifest.paths(folder / manifest.FOLDER, "state")
        frames = int(states[0].name.rpartition("-")[2]) if states else 0
        done = int(frames / self.config.trainer.total_frames * len(self.parts))
        left = self.parts[:STARTING] + self.parts[max(STARTING, done) :]
        chances = [lasts + INSTANT_SECONDS for _, lasts in left]
        saves = [lasts if letter in (SAVE, REMOVE) else 0.0 for letter, lasts in left]
        at_save = draw.random() < AT_SAVES and any(saves)
        [index] = draw.choices(range(len(left)), saves if at_save else chances)
        letter, lasts = left[index]
        nth = [each for each, _ in left[: index + 1]].count(letter)
        return Moment(letter, nth, draw.uniform(0, lasts))

    def check_whole(self, folder: Path) -> None:
        """Raises Broken where a checkpoint under its final name is not what was saved."""
        for path in manifest.paths(folder / manifest.FOLDER):
            try:
                manifest.verify(path)
            except manifest.Damaged as error:
                raise Broken(f"{self.kind}: {path.name} is unreadable: {error}") from error

    def compare(self, folder: Path) -> None:
        """Raises Broken where a file is not what it is without a kill."""
        left = contents(folder)
        for name in sorted(self.whole.keys() | left.keys()):
            if self.whole.get(name) != left.get(name):
                raise Broken(f"{self.kind}: {folder.name}/{name} is not that of the whole run")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too; but for TensorBoard's, which hold the time."""
    paths = (path for path in folder.rglob("*") if path.is_file())
    names = {str(path.relative_to(folder)): path for path in paths}
    return {name: path.read_bytes() for name, path in names.items() if "tfevents" not in name}


def fire(
    trainings: Sequence[Training], trials: int, seed: int = 0, seen: Seen | None = None
) -> Seen:
    """Kill runs of these trainings in turn, `trials` times in all; return what was seen.

    `seen` holds it before the end too. Raises Broken where a promise did not hold.
    """
    draw, seen = random.Random(seed), seen or Seen()
    while left := trials - seen.kills.total():
        training = trainings[seen.runs % len(trainings)]
        training.fire_at(draw, min(left, draw.randint(1, MOST_KILLS)), seen)
    return seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    began, seen = time.monotonic(), Seen()
    with suppress(KeyboardInterrupt), tempfile.TemporaryDirectory() as place:
        trainings = [Training(kind, Path(place)) for kind in arguments.kinds]
        fire(trainings, arguments.trials, arguments.seed, seen)
    kinds = ", ".join(arguments.kinds)
    sys.stdout.write(f"{kinds}: {seen}; {time.monotonic() - began:.0f} s\n")


if __name__ == "__main__":
    main()
