"""Two checkouts of this project timed interleaved: which is faster, and by how much.

A busy machine swings by more within a minute than most changes gain; in slices both swing alike.
And a process may by itself be 8 % faster than its equal, so both are started several times.
`python -m tests.benchmark.in_turns BEFORE AFTER [world|env|training ...]` with two folders, such as
that of `git worktree add BEFORE 6ec818b` and `.`. A folder against itself shows what is noise.
Ratios are seconds after over seconds before: below 1 is faster.
"""

import os
import statistics
import subprocess
import sys
from pathlib import Path

STARTS = 4
PAIRS = 12
# Written out, and not `benchmark`'s own, since that of an older checkout may be another.
IMPORTS = """
import sys, time
import torch
from marl_clean import build, keys
from marl_clean.world.dynamics import advance_
from marl_clean.world.sensing import crop
try:
    from marl_clean.config.compose import compose_config
    from marl_clean.config.schema import instantiate
    from marl_clean.storage.checkpoint import Checkpoints
except ModuleNotFoundError:  # a checkout from before these rooms
    from marl_clean.checkpoint import Checkpoints
    from marl_clean.compose import compose_config
    from marl_clean.schema import instantiate
"""
WORLDS = """
case = ["house.rows=[20,20]", "house.cols=[20,20]", "env.compile=true", "env.n_agents=3"]
env = build.make_env(compose_config([*case, "train_houses=64"]), num_envs=1024)
carried, worlds = env.reset(), env.base_env
generator = torch.Generator().manual_seed(0)
drawn = [torch.randint(0, 4, (1024, 3), generator=generator) for _ in range(32)]
warm_up, steps = 10, 150
"""
WORLD = f"""{WORLDS}
step, look = worlds.compiled(advance_), worlds.compiled(crop, wide=True)

def play(count):
    state, rules = worlds.state, worlds.rules
    for index in range(count):
        step(state, drawn[index % len(drawn)], worlds.moves, rules)
        look(state.record, state.position, state.step, 15, rules)
"""
ENV = f"""{WORLDS}
worlds.state.last_progress = worlds.state.step - torch.arange(1024) % 100  # staggered ends

def play(count):
    global carried
    for index in range(count):
        carried[keys.ACTION] = drawn[index % len(drawn)]
        _, carried = env.step_and_maybe_reset(carried)
"""
TRAINING = """
import logging, pathlib, tempfile
logging.getLogger("torchrl").setLevel(logging.WARNING)
torch.manual_seed(0)
cfg = compose_config(["trainer.start_frames=0", "train_houses=256"])
env = build.make_env(cfg)
agent = build.make_agent(cfg, env)
env, trainer = build.ready_for(agent, env), instantiate(cfg.trainer)
folder = pathlib.Path(tempfile.mkdtemp())
loop = trainer.begin(env, agent, lambda policy: {}, [], Checkpoints(folder))
collect = getattr(loop, "collect", None) or loop.play  # as it was called before

def play(count):
    for _ in range(count):
        loop.learn(collect())

warm_up, steps = 0, 1
"""
LOOP = """
play(2 * steps + 8)
for line in sys.stdin:
    play(warm_up)
    began = time.perf_counter()
    play(steps)
    print((time.perf_counter() - began) / steps, flush=True)
"""
WORKERS = {"world": WORLD, "env": ENV, "training": TRAINING}


def worker(folder: str, what: str) -> subprocess.Popen[str]:
    """Start a process that plays a slice for every line it is sent."""
    return subprocess.Popen(
        [sys.executable, "-c", IMPORTS + WORKERS[what] + LOOP],
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


def ratio(before: str, after: str, what: str) -> float:
    """Return the median ratio of interleaved slices of two new processes."""
    workers = [worker(before, what), worker(after, what)]
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


def main(before: str, after: str, *wanted: str) -> None:
    for what in wanted or WORKERS:
        ratios = sorted(ratio(before, after, what) for _ in range(STARTS))
        shown = ", ".join(f"{one:.2f}" for one in ratios)
        sys.stdout.write(f"{what}: after / before: {shown}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
