"""Two checkouts of this project, their whole env timed in turns: which is faster, and by how much.

A busy machine swings by more within a minute than most changes gain; in slices both swing alike.
And a process may by itself be 8 % faster than its equal, so both are started several times.
`python -m tests.benchmark.in_turns BEFORE AFTER` with two folders, such as that of
`git worktree add BEFORE 96de350` and `.`. A folder against itself tells what is noise.
"""

import os
import statistics
import subprocess
import sys
from pathlib import Path

STARTS = 4
PAIRS = 12
WARM_UP, STEPS = 10, 150
# Written out, and not the command `benchmark`, since that of an older checkout may be another.
WORKER = f"""
import sys, time
import torch
from marl_clean import build, keys
try:
    from marl_clean.config.compose import compose_config
except ImportError:  # an older checkout
    from marl_clean.compose import compose_config

rooms = ["house.rows=[20,20]", "house.cols=[20,20]", "train_houses=64"]
config = compose_config([*rooms, "env.compile=true", "env.num_envs=1024", "env.n_agents=3"])
env = build.make_env(config)
generator = torch.Generator().manual_seed(0)
drawn = [torch.randint(0, 4, (1024, 3), generator=generator) for _ in range(32)]
carried = env.reset()
state = env.base_env.state
state.last_progress = state.step - torch.arange(1024) % 100  # staggered ends

def play(count):
    global carried
    for index in range(count):
        carried[keys.ACTION] = drawn[index % len(drawn)]
        _, carried = env.step_and_maybe_reset(carried)

play(400)
for line in sys.stdin:
    play({WARM_UP})
    began = time.perf_counter()
    play({STEPS})
    print((time.perf_counter() - began) / {STEPS}, flush=True)
"""


def worker(folder: str) -> subprocess.Popen[str]:
    """Start a process that plays a slice for every line it is sent."""
    return subprocess.Popen(
        [sys.executable, "-c", WORKER],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(folder).resolve())},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def slice_seconds(process: subprocess.Popen[str]) -> float:
    """Return the seconds a step of the next slice."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return float(process.stdout.readline())


def ratio(before: str, after: str) -> float:
    """Return the median ratio of slices played in turns by two new processes."""
    workers = [worker(before), worker(after)]
    for process in workers:
        slice_seconds(process)
    taken = []
    for pair in range(PAIRS):
        order = (0, 1) if pair % 2 else (1, 0)
        seconds = {which: slice_seconds(workers[which]) for which in order}
        taken.append(seconds[1] / seconds[0])
    for process in workers:
        process.communicate()
    return statistics.median(taken)


def main(before: str, after: str) -> None:
    ratios = sorted(ratio(before, after) for _ in range(STARTS))
    sys.stdout.write(f"after / before: {', '.join(f'{one:.2f}' for one in ratios)}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
