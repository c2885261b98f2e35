"""A tiny env with the keys of the real one, that can only be solved by talking.

Each robot sees a code, one of four cells blocked, and is paid 1 for the action that its
neighbour's code names. What it sees itself says nothing about what to do.
"""

from collections import OrderedDict

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Categorical, Composite, Unbounded

from marl_clean import keys
from marl_clean.env.base import BatchedEnv

SIDE = 9
CELLS = ((1, 4), (4, 7), (7, 4), (4, 1))
N_AGENTS = 2


class Probe(BatchedEnv):
    """Episodes end after 5 steps, terminated in even worlds and truncated in odd ones."""

    batch_locked = True

    def __init__(self, num_envs: int = 16, seed: int = 0, bad_reward_at: int | None = None):
        super().__init__(device="cpu", batch_size=[num_envs])
        self.num_envs, self.bad_reward_at = num_envs, bad_reward_at
        agents = torch.Size([num_envs, N_AGENTS])
        square, pair = torch.Size([1, SIDE, SIDE]), torch.Size([N_AGENTS])

        def of_agents(**specs) -> Composite:
            return Composite(agents=Composite(**specs, shape=agents), shape=self.batch_size)

        self.observation_spec = of_agents(
            observation=Unbounded(agents + square),
            adjacency=Binary(shape=agents + pair, dtype=torch.bool),
            distance_rank=Unbounded(agents + pair, dtype=torch.int64),
            episode_reward=Unbounded(torch.Size([*agents, 1])),
        )
        self.action_spec = of_agents(action=Categorical(4, shape=agents))
        scalar = torch.Size([*agents, 1])
        self.reward_spec = of_agents(reward=Unbounded(scalar), own_reward=Unbounded(scalar))
        flag = Binary(shape=torch.Size([num_envs, 1]), dtype=torch.bool)
        self.done_spec = Composite(
            **{name: flag.clone() for name in keys.ENDINGS}, shape=self.batch_size
        )
        self.steps_taken = 0
        self.step_count = torch.zeros(num_envs, dtype=torch.int64)
        self.code = torch.zeros(num_envs, N_AGENTS, dtype=torch.int64)
        self.earned = torch.zeros(num_envs, N_AGENTS, 1)
        self._set_seed(seed)

    @property
    def base_env(self) -> "Probe":
        return self

    def progress(self) -> dict[str, float]:
        return {"coverage": float(self.step_count.double().mean() / 5)}

    def _set_seed(self, seed: int | None) -> None:
        self.draw = torch.Generator().manual_seed(seed or 0)

    def _seen(self) -> dict:
        observation = torch.full((self.num_envs, N_AGENTS, 1, SIDE, SIDE), -0.2)
        for code, (row, col) in enumerate(CELLS):
            observation[..., 0, row, col] = torch.where(self.code == code, -1.0, 0.0)
        other = 1 - torch.eye(N_AGENTS, dtype=torch.int64)
        rank = other.expand(self.num_envs, N_AGENTS, N_AGENTS).clone()
        return {"observation": observation, "adjacency": rank.bool(), "distance_rank": rank}

    def _redraw(self) -> None:
        self.code = torch.randint(4, (self.num_envs, N_AGENTS), generator=self.draw)

    def _answer(self, agents: dict, done: torch.Tensor, even: torch.Tensor) -> TensorDict:
        return TensorDict(
            {
                keys.AGENTS: TensorDict(agents, [self.num_envs, N_AGENTS]),
                "done": done,
                "terminated": done & even,
                "truncated": done & ~even,
            },
            self.batch_size,
        )

    def _reset(self, tensordict=None, **kwargs):
        mask = torch.ones(self.num_envs, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].view(-1)
        self.step_count = self.step_count.masked_fill(mask, 0)
        self.earned = self.earned.masked_fill(mask[:, None, None], 0)
        if mask.all():
            self._redraw()
        done = torch.zeros(self.num_envs, 1, dtype=torch.bool)
        return self._answer(self._seen() | {"episode_reward": self.earned.clone()}, done, done)

    def _step(self, tensordict):
        right = tensordict[keys.ACTION] == self.code.flip(-1)
        self.steps_taken += 1
        reward = right.float().unsqueeze(-1)
        if self.steps_taken == self.bad_reward_at:
            reward = reward * torch.nan
        self.earned = self.earned + reward
        self.step_count = self.step_count + 1
        self._redraw()
        paid = {"reward": reward, "own_reward": reward, "episode_reward": self.earned.clone()}
        even = torch.arange(self.num_envs).unsqueeze(-1) % 2 == 0
        return self._answer(self._seen() | paid, (self.step_count == 5).unsqueeze(-1), even)

    def state_dict(self, *args, **kwargs):
        return OrderedDict(
            draw=self.draw.get_state(),
            step_count=self.step_count,
            code=self.code,
            earned=self.earned,
            steps_taken=torch.tensor(self.steps_taken),
        )

    def load_state_dict(self, state_dict, *args, **kwargs):
        self.draw.set_state(state_dict["draw"])
        self.step_count, self.code = state_dict["step_count"], state_dict["code"]
        self.earned, self.steps_taken = state_dict["earned"], int(state_dict["steps_taken"])


def share_right(policy, worlds: int = 64) -> float:
    """Mean reward of one step of a policy: 0.25 is guessing, 1 is knowing."""
    env = Probe(worlds, seed=99)
    return env.step(policy(env.reset()))["next", keys.REWARD].mean().item()
