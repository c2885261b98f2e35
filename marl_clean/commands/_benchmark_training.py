"""What training costs: presets in turns, where the time of each goes, and the memory it takes.

Part of `marl-clean benchmark`; `python -m marl_clean.commands._benchmark_training` runs it alone.
"""

import logging
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.table import Table

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.evaluation.evaluator import validate
from marl_clean.evaluation.table import output
from marl_clean.observation.base import Observation
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer._collectors import InTheTrainer
from marl_clean.trainer._share import share_maker
from marl_clean.trainer.off_policy import OffPolicyLoop

PRESETS = {
    "any_house": ["trainer.imitate=null"],  # its training after the warm start
    "approach_2_frontier": ["trainer.start_frames=0"],  # learns from the first block on
}
"""What is timed, with overrides that skip the beginning of a run."""
ROUNDS = 8
SLICE_SECONDS = 2.0
PARTS = ("observation", "world", "network", "learning", "rest")
MIB = 2**20


@dataclass(frozen=True)
class Training:
    """What a preset's training costs.

    Attributes:
        what: the preset.
        frames_per_second: median of the slices; a frame is a step of one world.
        robot_steps_per_second: the same in steps of single robots.
        ratio: median ratio of robot-steps/s to those of the last preset, slice by slice.
        shares: of the time, by PARTS: observing; the rest of a step of the env; acting;
            learning; and the rest of the loop. Empty on a GPU, where calls return
            before the work is done.
        peak_memory_mib: of a process that trains, with a full replay, and validates.
    """

    what: str
    frames_per_second: float
    robot_steps_per_second: float
    ratio: float
    shares: Mapping[str, float]
    peak_memory_mib: float


class Session:
    """A training that advances by slices of time, in turns with others."""

    def __init__(self, overrides: Sequence[str], folder: Path) -> None:
        self.cfg = compose_config(overrides)
        torch.manual_seed(self.cfg.seed)
        env = build.make_env(self.cfg)
        self.agent = build.make_agent(self.cfg, env)
        env, trainer = build.ready_for(self.agent, env), instantiate(self.cfg.trainer)
        self.loop = trainer.begin(
            env,
            self.agent,
            lambda policy: {},
            [],
            Checkpoints(folder),
            share_maker(self.cfg),
        )
        self.device, self.robots = env.device, env.base_env.n_agents
        self.elapsed = 0.0
        self.seconds = dict.fromkeys(("observation", "step", "network", "learning"), 0.0)
        for transform in env.transforms:
            if isinstance(transform, Observation):
                self._time(transform, "read", "observation")
        self._time(env, "step_and_maybe_reset", "step")
        collecting = self.loop.collectors
        assert isinstance(collecting, InTheTrainer)  # what other processes take is not timed
        self._time(collecting.warm_start.policy, "forward", "network")
        self._time(self.loop, "learn", "learning")

    def _time(self, owner: Any, name: str, part: str) -> None:
        """Add the time of a method's calls to a part, from now on."""
        function: Callable = getattr(owner, name)

        def timed(*arguments: Any, **keywords: Any) -> Any:
            began = time.perf_counter()
            result = function(*arguments, **keywords)
            self.seconds[part] += time.perf_counter() - began
            return result

        setattr(owner, name, timed)

    def run(self, seconds: float) -> float:
        """Train for at least so long, by whole blocks; return the frames a second."""
        frames, began = 0, time.perf_counter()
        while not frames or time.perf_counter() - began < seconds:
            block = self.loop.collect()
            self.loop.learn(block)
            frames += block.numel()
        wait_for(self.device)
        taken = time.perf_counter() - began
        self.elapsed += taken
        return frames / taken

    def reset_clocks(self) -> None:
        """Reset the clocks of all parts."""
        self.elapsed, self.seconds = 0.0, dict.fromkeys(self.seconds, 0.0)

    def shares(self) -> dict[str, float]:
        """Return which share of the time each of PARTS took."""
        if self.device.type != "cpu":
            return {}
        shares = {part: seconds / self.elapsed for part, seconds in self.seconds.items()}
        shares["world"] = shares.pop("step") - shares["observation"]
        shares["rest"] = 1 - sum(shares.values())
        return {part: shares[part] for part in PARTS}

    def fill(self) -> None:
        """Fill the replay, if there is one, as in a long run."""
        if isinstance(self.loop, OffPolicyLoop):
            replay = self.loop.replay
            frames = replay.storage[: len(replay)].clone()
            while len(replay) < replay.storage.max_size:
                replay.extend(frames)


def costs_of_training(
    device: str = "cpu", rounds: int = ROUNDS, slice_seconds: float = SLICE_SECONDS
) -> list[Training]:
    """Train all of PRESETS in turns, so that a busy machine slows all of them equally."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every buffer it makes
    cases = {
        name: [f"+experiment={name}", f"device={device}", *settings]
        for name, settings in PRESETS.items()
    }
    memory = {name: peak_memory(overrides) for name, overrides in cases.items()}
    with tempfile.TemporaryDirectory() as folder:
        sessions = {name: Session(case, Path(folder) / name) for name, case in cases.items()}
        for session in sessions.values():
            session.run(slice_seconds)
            session.reset_clocks()
        speeds: dict[str, list[float]] = {name: [] for name in sessions}
        for _ in range(rounds):
            for name, session in sessions.items():
                speeds[name].append(session.run(slice_seconds) * session.robots)
    *_, last = speeds.values()
    return [
        Training(
            what=name,
            frames_per_second=statistics.median(speeds[name]) / session.robots,
            robot_steps_per_second=statistics.median(speeds[name]),
            ratio=statistics.median(a / b for a, b in zip(speeds[name], last, strict=True)),
            shares=session.shares(),
            peak_memory_mib=memory[name] / MIB,
        )
        for name, session in sessions.items()
    ]


def peak_memory(overrides: Sequence[str]) -> int:
    """Return the peak memory in bytes of a separate process that trains with these overrides."""
    command = [sys.executable, "-W", "ignore", "-m", __spec__.name, *overrides]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return int(done.stdout.split()[-1])


def train_and_validate(overrides: Sequence[str]) -> int:
    """Train on one block, fill the replay, validate, and return this process's peak in bytes."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        session = Session(overrides, Path(folder))
        session.run(0.0)
        session.fill()
        with torch.no_grad():
            validate(session.cfg, session.agent.policy())
    return own_peak()


def own_peak() -> int:
    """Return this process's peak memory in bytes.

    On Linux from /proc: in `getrusage` a process inherits the peak of its parent.
    """
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    peaks = [int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")]
    unit = 1 if sys.platform == "darwin" else 1024
    return peaks[0] if peaks else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def wait_for(device: torch.device) -> None:
    """Block until everything queued on a GPU has been computed."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def table_of_training(costs: Sequence[Training]) -> Table:
    """A column for each preset."""
    table = Table(title="training, after its warm start and without validation")
    table.add_column("what", no_wrap=True)
    for cost in costs:
        table.add_column(cost.what, justify="right", no_wrap=True)
    table.add_column("wanted", justify="right", no_wrap=True)

    def add(what: str, cells: Sequence[str], wanted: str = "") -> None:
        table.add_row(what, *cells, wanted)

    add("frames/s", [f"{cost.frames_per_second:,.0f}" for cost in costs])
    add("robot-steps/s", [f"{cost.robot_steps_per_second:,.0f}" for cost in costs])
    add("ratio", [f"{cost.ratio:.2f}" for cost in costs], ">= 5.00")
    for part in PARTS if all(cost.shares for cost in costs) else ():
        shares = [f"{cost.shares[part]:.2f}" for cost in costs]
        add(f"time in {part}", shares, "<= 0.30" if part == "observation" else "")
    add("peak memory, MiB", [f"{cost.peak_memory_mib:,.0f}" for cost in costs])
    return table


if __name__ == "__main__":
    if len(sys.argv) > 1:
        sys.stdout.write(f"{train_and_validate(sys.argv[1:])}\n")
    else:
        output().print(table_of_training(costs_of_training()))
