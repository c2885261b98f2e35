"""Equal seeds, equal bits: `python -m tests.reliability.determinism --steps 10000`.

Worlds: env i of 64 plays what env i plays alone, over many resets, to the last bit: every entry of
every frame, and what channels deliver. Trainings: two fresh processes with the same seed end with
the same weights and the same metrics.csv, with one thread and with two, whatever each of them
trained before; another seed ends with others.
"""

import argparse
import hashlib
import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from marl_clean import build, keys
from marl_clean.channel.base import Channel
from marl_clean.channel.delayed import Delayed
from marl_clean.channel.lossy import Lossy
from marl_clean.channel.noisy import Noisy
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.learning.delivery import Stacked
from marl_clean.logger.csv import Csv
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._first_updates import digest_of

WORLDS, N_AGENTS, MESSAGE = 64, 3, 8
ALONE = (0, 41)
SMALL = [
    *("train_houses=16", "house.rows=[5,8]", "house.cols=[5,9]", "observation.view_size=7"),
    *(f"env.n_agents={N_AGENTS}", "env.stuck_after=8", "env.max_steps=12"),
]
NOISE = ["env.bump_noise=0.3", "observation.position_noise=0.3"]
SPILLS = ["env.spills.per_episode=3", "env.spills.noticed_within=2"]
FURNITURE = ["env.furniture_moves_per_episode=4"]
READINGS = {
    "shared": [*NOISE, *SPILLS, *FURNITURE],
    "private": ["env.memory=private", "topology=sight", *NOISE, *SPILLS, *FURNITURE],
    "merged": [
        *("env.memory=merged", "topology=radius", "reward=team", *NOISE, *FURNITURE),
        *("env.knowledge=stale", "env.furniture_moves_before_start=3"),
    ],
}
TINY = [
    *("trainer.total_frames=256", "trainer.frames_per_batch=64", "trainer.log_interval_frames=128"),
    "trainer.eval_interval_frames=128",
    *("train_houses=8", "house.rows=[5,7]", "house.cols=[5,8]", "env.num_envs=8"),
    *("env.max_steps=20", "encoder.hidden=[16]", "observation.view_size=7"),
]
OFF = ["trainer.start_frames=64", "trainer.batch_frames=32"]
ON = ["trainer=on_policy", "trainer.minibatch_frames=32"]
NOISY = ["channel=[lossy,noisy]", "env.bump_noise=0.3", "encoder.dropout=0.1"]
LEARNERS = {
    "iql": [*OFF, *NOISY],
    "vdn": ["agent=vdn", "reward=team", *OFF, *NOISY],
    "qmix": ["agent=qmix", "reward=team", *OFF, *NOISY],
    "central_dqn": ["agent=central_dqn", "reward=team", "comm=none", *OFF],
    "pqn": ["agent=pqn", *ON, *NOISY],
    "ippo": ["agent=ippo", "encoder.memory=gru", *ON, *NOISY],
    "mappo": ["agent=mappo", *ON, *NOISY],
}


class Play:
    """Worlds that are stepped, and messages that cross channels which draw."""

    def __init__(self, settings: Sequence[str], num_envs: int, first_env: int, seed: int) -> None:
        config = compose_config([*SMALL, f"seed={seed}", *settings])
        self.env = build.make_env(config, num_envs=num_envs, first_env=first_env, seeded=True)
        lossy, noisy = Lossy(0.2, 0.2, 0.4, 0.9), Noisy(0.5)
        self.channels: list[Channel] = [lossy, Delayed(2, True, (MESSAGE,)), noisy]
        self.carried = self.env.reset()
        self.states = [self.nothing(channel) for channel in self.channels]

    def nothing(self, channel: Channel) -> torch.Tensor | None:
        """Return what a channel remembers as an episode begins."""
        if channel.remembers is None:
            return None
        return channel.state_spec(N_AGENTS, (MESSAGE,)).zero(self.env.batch_size)

    def step(self, action: torch.Tensor) -> TensorDictBase:
        """Step all worlds, those that end into their next episodes; return all that is seen."""
        frame = self.carried
        heard = self.deliver(frame)
        frame[keys.ACTION] = action
        step, self.carried = self.env.step_and_maybe_reset(frame)
        for state in self.states:
            if state is not None:
                state[step["next", keys.DONE].flatten()] = 0
        return step.clone().update(heard)

    def deliver(self, frame: TensorDictBase) -> dict[str, torch.Tensor]:
        """Return what arrives, and over which edges, of messages that say where each robot is."""
        stacked = Stacked(
            self.channels,
            frame[keys.ADJACENCY],
            frame[keys.DISTANCE_RANK],
            1,
            frame[keys.CHANNEL_SEED],
            self.states,
        )
        message = frame[keys.OBSERVATION].flatten(2)[..., :MESSAGE]
        with torch.no_grad():
            heard, edges = stacked(message, 0)
            after = stacked.states_after()
        self.states = [None if c.remembers is None else after[c.remembers] for c in self.channels]
        return {"heard": heard, "live": edges}


def difference(settings: Sequence[str], steps: int, seed: int = 0) -> str | None:
    """Play env i among 64 and alone; return where they first differ, or None."""
    draw = torch.Generator().manual_seed(seed)
    together = Play(settings, WORLDS, 0, seed)
    alone = {index: Play(settings, 1, index, seed) for index in ALONE}
    ended = 0
    for step in range(steps):
        action = torch.randint(4, (WORLDS, N_AGENTS), generator=draw)
        frames = together.step(action)
        ended += int(frames["next", keys.DONE].sum())
        for index, play in alone.items():
            own = play.step(action[index : index + 1])
            for key in own.keys(True, True):
                if not torch.equal(own[key], frames[key][index : index + 1]):
                    return f"step {step}, env {index}: {key} differs"
    assert ended >= WORLDS, f"{ended} episodes ended: too few to say anything of resets"
    return None


def trained(learner: str, seed: int, threads: int, folder: Path) -> str:
    """Train in this process; return a digest of the last weights, and of the rows of metrics.

    As the command does, but for validation: in its place stands a sum of the weights.
    """
    torch.set_num_threads(threads)
    config = compose_config([*TINY, *LEARNERS[learner], f"seed={seed}", "name=run"])
    torch.manual_seed(seed)
    env = build.make_env(config)
    agent = build.make_agent(config, env)
    env = build.ready_for(agent, env)
    folder.mkdir()

    def evaluate(policy: TensorDictModuleBase) -> dict[str, float]:
        return {"T_100": sum(float(weight.sum()) for weight in policy.parameters())}

    instantiate(config.trainer).train(env, agent, evaluate, [Csv(folder)], folder)
    final = Checkpoints(folder / FOLDER).newest("final")
    assert final is not None and final.frames == config.trainer.total_frames
    rows = hashlib.sha256((folder / "metrics.csv").read_bytes()).hexdigest()
    return f"{digest_of(final.tree)} {rows}"


def worker(jobs: Sequence[str]) -> None:
    """Train `learner:seed:threads` one after another; print the digests as JSON."""
    digests = {}
    with tempfile.TemporaryDirectory() as place:
        for job in jobs:
            learner, seed, threads = job.split(":")
            digests[job] = trained(learner, int(seed), int(threads), Path(place) / job)
    sys.stdout.write(json.dumps(digests) + "\n")


def in_a_process(jobs: Sequence[str]) -> dict[str, str]:
    """Run `worker` in a fresh process, in which strings hash as they happen to."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONHASHSEED"}
    command = [sys.executable, "-m", "tests.reliability.determinism", "--worker", *jobs]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def compared(jobs: Sequence[str]) -> list[str]:
    """Train the jobs in one process, and backwards in another; return what broke the promise."""
    first, second = in_a_process(jobs), in_a_process(list(reversed(jobs)))
    broken = [f"{job}: two processes differ" for job in jobs if first[job] != second[job]]
    by_learner_and_threads: dict[tuple[str, str], list[str]] = {}
    for job in jobs:
        learner, _, threads = job.split(":")
        by_learner_and_threads.setdefault((learner, threads), []).append(first[job])
    for group, digests in by_learner_and_threads.items():
        if len(set(digests)) < len(digests):
            broken.append(f"{':'.join(group)}: other seeds, the same run")
    return broken


def lines(steps: int, seeds: Sequence[int], learners: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Run everything; yield a line for each part, and how often it broke the promise."""
    for name, settings in READINGS.items():
        for seed in seeds:
            where = difference(settings, steps, seed)
            said = "0 differences" if where is None else where
            played = f"{name}, seed {seed}: env {ALONE} of {WORLDS} and alone, {steps} steps"
            yield f"{played}: {said}", int(where is not None)
    jobs = [f"{name}:{seed}:{n}" for name in learners for seed in (0, 1) for n in (1, 2)]
    broken = compared(jobs)
    said = "; ".join(broken) or "0 differences"
    yield f"trainings: {len(jobs)} jobs, each in two processes: {said}", len(broken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--worker", nargs="+", metavar="LEARNER:SEED:THREADS")
    arguments = parser.parse_args()
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    if arguments.worker:
        worker(arguments.worker)
        return
    torch.set_num_threads(1)
    total = 0
    for line, broken in lines(arguments.steps, arguments.seeds, arguments.learners):
        total += broken
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    sys.exit(1 if total else 0)


if __name__ == "__main__":
    main()
