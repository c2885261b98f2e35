"""The arithmetic of the default training run as a bare PyTorch loop, to be timed against.

No TorchRL, no TensorDict, no logs: world functions, arrays for a replay, double Q-learning.
`python -m tests.benchmark.bare_dqn [key=value ...]` times both, turn about, on one thread.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import torch
from torch import nn

from marl_clean import build, keys
from marl_clean.agent.iql import Iql
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.trainer.off_policy import OffPolicy
from marl_clean.world.dynamics import advance_, episode_ends
from marl_clean.world.sensing import crop, distance_rank, in_view
from tests.agent.parts import by_key

FRAMES = 16_384
PAIRS = 5


class Bare:
    """Worlds, replay and learner of a config with shared maps, `view` and `neighbours`."""

    def __init__(self, cfg, env, agent: Iql) -> None:
        self.env, self.view_size = env.base_env, cfg.observation.view_size
        self.trainer, self.settings = cfg.trainer, cfg.agent
        self.network = agent.network
        self.target = build_agent(cfg, env).network
        self.target.load_state_dict(self.network.state_dict())
        self.adam = torch.optim.Adam(self.network.parameters(), lr=cfg.agent.lr, fused=True)
        self.env.reset()
        worlds, robots = self.env.num_envs, self.env.n_agents
        size, side = cfg.trainer.buffer_frames // worlds, self.view_size
        self.seen = {
            "observation": torch.zeros(size, worlds, robots, 1, side, side),
            "adjacency": torch.zeros(size, worlds, robots, robots, dtype=torch.bool),
            "rank": torch.zeros(size, worlds, robots, robots, dtype=torch.int64),
        }
        self.then = {name: torch.zeros_like(value) for name, value in self.seen.items()}
        self.action = torch.zeros(size, worlds, robots, dtype=torch.int64)
        self.reward = torch.zeros(size, worlds, robots)
        self.discount = torch.zeros(size, worlds, 1)  # 0 where nothing is to be bootstrapped
        self.size, self.step, self.window = size, 0, []

    def observe(self, state) -> tuple:
        view = crop(state.record, state.position, state.step, self.view_size, self.env.rules)
        adjacency = in_view(state.position, self.view_size)
        return view.unsqueeze(2), adjacency, distance_rank(state.position)

    @torch.no_grad()
    def play(self, now: tuple, epsilon: float) -> tuple:
        env = self.env
        action = self.network(by_key(now)).out.argmax(-1)
        random = torch.rand(action.shape) < epsilon
        action = torch.where(random, torch.randint(4, action.shape), action)
        outcome = advance_(env.state, action, env.moves, env.rules)
        terminated, truncated = episode_ends(env.state, env.rules.stuck_after)
        own = outcome.own_reward
        reward = (own + now[1].float() @ own).squeeze(-1)
        then, done = self.observe(env.state), terminated | truncated
        self.remember(now, action, reward, then, terminated, done)
        if done.any():
            rows = done.nonzero()[:, 0]
            fresh = self.observe(env.begin_rows(rows)[0])
            then = tuple(x.index_copy(0, rows, y) for x, y in zip(then, fresh, strict=True))
        return then

    def remember(self, now, action, reward, then, terminated, done) -> None:
        self.window.append((now, action, reward, then, terminated, done))
        if len(self.window) < self.settings.n_steps:
            return
        first, chosen, total, last, ended, over = self.window[0]
        power = torch.full_like(total[:, :1], self.settings.gamma)
        for k, (_, _, later, seen, final, stop) in enumerate(self.window[1:], start=1):
            going = ~over[:, None]
            total = total + going * self.settings.gamma**k * later
            power = torch.where(going, self.settings.gamma ** (k + 1), power)
            last = tuple(
                torch.where(going.view(-1, *[1] * (x.ndim - 1)), x, y)
                for x, y in zip(seen, last, strict=True)
            )
            ended, over = ended | (final & going[:, 0]), over | stop
        slot = self.step % self.size
        for store, value in zip(self.seen.values(), first, strict=True):
            store[slot] = value
        for store, value in zip(self.then.values(), last, strict=True):
            store[slot] = value
        self.action[slot], self.reward[slot] = chosen, total
        self.discount[slot] = power * ~ended[:, None]
        self.step += 1
        self.window.pop(0)

    def learn(self) -> None:
        filled = min(self.step, self.size) * self.env.num_envs
        index = torch.randint(filled, (self.trainer.batch_frames,))
        now, then = ([x.flatten(0, 1)[index] for x in s.values()] for s in (self.seen, self.then))
        action, reward, discount = (
            x.flatten(0, 1)[index] for x in (self.action, self.reward, self.discount)
        )
        with torch.no_grad():
            best = self.network(by_key(then)).out.argmax(-1, keepdim=True)
            goal = reward + discount * self.target(by_key(then)).out.gather(-1, best)[..., 0]
        value = self.network(by_key(now)).out.gather(-1, action[..., None])[..., 0]
        loss = nn.functional.smooth_l1_loss(value, goal)
        self.adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.max_grad_norm)
        self.adam.step()
        with torch.no_grad():
            slow, fast = list(self.target.parameters()), list(self.network.parameters())
            torch._foreach_lerp_(slow, fast, self.settings.tau)

    def train(self) -> None:
        trainer, num_envs = self.trainer, self.env.num_envs
        frames = updates = 0
        self.env.reset()
        now = self.observe(self.env.state)
        while frames < trainer.total_frames:
            progress = frames / trainer.total_frames / self.settings.annealing_fraction
            epsilon = max(self.settings.eps_end, 1 - progress * (1 - self.settings.eps_end))
            for _ in range(trainer.frames_per_batch // num_envs):
                now = self.play(now, epsilon)
            frames += trainer.frames_per_batch
            owed = int(max(0, frames - trainer.start_frames) * trainer.replay_ratio)
            while updates < owed // trainer.batch_frames:
                self.learn()
                updates += 1


def build_agent(cfg, env) -> Iql:
    shape = env.observation_spec[keys.OBSERVATION].shape[2:]
    encoder = build.make_encoder(cfg, shape)
    comm = build.make_comm(cfg.comm, encoder.out_features, shape)
    return instantiate(cfg.agent, encoder=encoder, comm=comm)


def seconds(cfg, bare: bool) -> float:
    """CPU seconds of one run on new worlds, set-up not counted."""
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build_agent(cfg, env)
    trainer: OffPolicy = instantiate(cfg.trainer)
    loop = Bare(cfg, env, agent) if bare else None
    with tempfile.TemporaryDirectory() as folder:
        started = time.process_time()
        if loop is not None:
            loop.train()
        else:
            trainer.train(env, agent, lambda policy: {"T_100": 0.0}, [], Path(folder))
        return time.process_time() - started


def main(overrides: list[str]) -> None:
    torch.set_num_threads(1)
    cfg = compose_config(
        [f"trainer.total_frames={FRAMES}", "trainer.start_frames=1024", *overrides]
    )
    seconds(cfg, bare=True)  # warms up
    taken = [(seconds(cfg, bare=True), seconds(cfg, bare=False)) for _ in range(PAIRS)]
    total = cfg.trainer.total_frames
    bare, ours = (total / statistics.median(column) for column in zip(*taken, strict=True))
    ratio = statistics.median(theirs / mine for theirs, mine in taken)
    sys.stdout.write(f"bare {bare:.0f} frames/s, ours {ours:.0f}, ratio {ratio:.3f}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
