"""Two doors, one open: one robot sees which, only the other stands before them.

Maps are private and everybody hears everybody. Robot 0's square shows which door is open; robot
1's shows both, whichever it is. Both robots are paid 1 when robot 1 takes the open door. A door
stays open for `hold` steps and only the last of them pays, so with `hold=1` the message must cross
within the step, and with `hold=2` it may be a step late. Nothing else tells robot 1 where to go:
without a message it is right half of the time.
"""

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Unbounded
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from marl_clean import build, keys
from marl_clean.learning.agent import Agent
from tests.trainer.probe import N_AGENTS, SIDE, Probe

LEFT, RIGHT = 3, 1
STATE_SHAPE = (1, 1, 2)  # which door is open
CELLS = {LEFT: (4, 0), RIGHT: (4, 8)}


class Doors(Probe):
    """Robots before two doors; `code` 0 is the left one."""

    def __init__(self, num_envs: int = 16, seed: int = 0, hold: int = 1):
        self.hold = hold
        super().__init__(num_envs, seed)
        state = Binary(shape=torch.Size([num_envs, *STATE_SHAPE]), dtype=torch.bool)
        self.observation_spec[keys.STATE] = state  # for mixers
        pairs = torch.Size([num_envs, N_AGENTS, N_AGENTS, 2])
        self.observation_spec[keys.OFFSET] = Unbounded(pairs, dtype=torch.int64)

    def _answer(self, agents: dict, done: torch.Tensor, even: torch.Tensor) -> TensorDict:
        answer = super()._answer(agents, done, even)
        left = self.code[:, 0] == 0
        answer[keys.STATE] = torch.stack([left, ~left], dim=-1).view(-1, *STATE_SHAPE)
        return answer

    def _seen(self) -> dict:
        seen = super()._seen()
        square = torch.full((self.num_envs, N_AGENTS, 1, SIDE, SIDE), -0.2)
        for door, cell in enumerate(CELLS.values()):
            square[:, :, 0, *cell] = 0.0
            shut = self.code[:, 0] != door
            square[:, 0, 0, *cell] = torch.where(shut, -1.0, 0.0)
        apart = torch.tensor([[[0, 0], [0, 3]], [[0, -3], [0, 0]]])
        return seen | {"observation": square, "offset": apart.repeat(self.num_envs, 1, 1, 1)}

    def _redraw(self) -> None:
        drawn = torch.randint(2, (self.num_envs, 1), generator=self.draw).expand(-1, N_AGENTS)
        new = self.step_count % self.hold == 0
        self.code = torch.where(new[:, None], drawn, self.code)

    def _step(self, tensordict):
        pays = self.step_count % self.hold == self.hold - 1
        action = tensordict[keys.ACTION][:, 1]
        right = action == torch.tensor(list(CELLS))[self.code[:, 0]]
        reward = (right & pays).float()[:, None, None].expand(-1, N_AGENTS, 1).clone()
        self.steps_taken += 1
        self.earned = self.earned + reward
        self.step_count = self.step_count + 1
        self._redraw()
        paid = {"reward": reward, "own_reward": reward, "episode_reward": self.earned.clone()}
        done = (self.step_count == 6).unsqueeze(-1)
        return self._answer(self._seen() | paid, done, torch.ones_like(done))


def doors_for(agent: Agent, hold: int, num_envs: int = 16, seed: int = 0) -> TransformedEnv:
    """Return the task, as an env whose episodes begin as the agent wants."""
    return build.ready_for(agent, TransformedEnv(Doors(num_envs, seed, hold), Compose()))


def share_right(agent: Agent, hold: int, num_envs: int = 256) -> float:
    """How often robot 1 takes the open door where it pays; 0.5 is guessing between the two."""
    env, policy = doors_for(agent, hold, num_envs, seed=99), agent.policy()
    right = []
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        td = env.reset()
        for step in range(6):
            td = env.step(policy(td))
            if step % hold == hold - 1:
                right.append(td["next", keys.REWARD][:, 1].mean())
            td = step_mdp(td)
    return torch.stack(right).mean().item()
