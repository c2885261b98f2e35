"""A probe without houses: one robot sees a bit, and the others are paid for acting on it."""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, final

import torch
from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded

from marl_clean import keys
from marl_clean.env.base import BatchedEnv
from marl_clean.errors import BadInput
from marl_clean.settings import Form, PositiveInt, Worlds
from marl_clean.world.random import Purpose, random_below

Among = Callable[[int], Bool[Tensor, "agent agent"]]


@final
class LeaderBit(BatchedEnv):
    """The least task that only a message solves.

    ## Description
    In each episode one robot, drawn anew, is the leader, and it alone sees a bit, drawn anew too.
    The others are followers: whoever acts as the bit says gains 1, whoever does not loses 1. A
    follower without word of the bit earns 0 on average, whatever it does. The rooms house,
    observation and planner have no effect.

    ## Actions
    `("agents", "action")`, int64 `[num_envs, n_agents]`: 0 or 1. The leader's has no effect.

    ## Observations
    `("agents", "observation")`, float32 `[num_envs, n_agents, 3]`: whether the robot leads, then,
    for the leader alone, whether the bit is 0 and whether it is 1.
    `("agents", "adjacency")`, the topology's, always the same: robots have no positions.
    `("agents", "distance_rank")`: without distances, the others in their order.
    `("agents", "own_reward")`, float32 `[num_envs, n_agents, 1]`; 0 after a reset.

    ## Rewards
    `("agents", "reward")`, float32 `[num_envs, n_agents, 1]`: what a robot is paid, its
    `own_reward` unless a transform of `marl_clean.reward` splits otherwise. The most that a team
    can earn in an episode is `(n_agents - 1) * max_steps`.

    ## Starting state
    Leader and bit are functions of (seed, env index, episode).

    ## Episode end
    `terminated` after `max_steps`: nothing follows that a learner should expect. More than one step
    leaves schemes whose messages arrive a step later something to win.

    Args:
        n_agents: robots in each world, at least two.
        num_envs: worlds stepped together.
        max_steps: steps of an episode.
        among: who may talk to whom among n robots: a topology's `among`.
        first_env: index of the first world: env i of 64 equals a single env with `first_env=i`.
        seed: the seed of everything drawn.
        device: where the tensors live.

    Raises:
        BadInput: a team without a follower.

    Source: ours; a signalling game of D. Lewis, "Convention" (1969), with contact as the channel.
    """

    episode: Int[Tensor, " env"]  # the present one of each world
    step_count: Int[Tensor, " env"]
    batch_locked = True
    gives = Form.VECTOR

    def __init__(
        self,
        n_agents: PositiveInt = 2,
        num_envs: Worlds = 128,
        max_steps: PositiveInt = 8,
        *,
        among: Among,
        first_env: int = 0,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(device=device, batch_size=[num_envs])
        if n_agents < 2:
            raise BadInput(f"env.n_agents={n_agents}: a leader needs a follower; valid: 2 or more")
        self.n_agents, self.num_envs, self.max_steps = n_agents, num_envs, max_steps
        robots = torch.arange(n_agents, device=self.device)
        rank = (robots + (robots < robots[:, None])).fill_diagonal_(0)
        self.graph = {
            "adjacency": among(n_agents).to(self.device).expand(num_envs, -1, -1),
            "distance_rank": rank.expand(num_envs, -1, -1),
        }
        self.env_index = torch.arange(first_env, first_env + num_envs, device=self.device)
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        agents = torch.Size([self.num_envs, self.n_agents])
        pairs = torch.Size([*agents, self.n_agents])
        flag = Binary(1, torch.Size([self.num_envs, 1]), dtype=torch.bool)

        def of_agents(**specs: Any) -> Composite:
            return Composite(agents=Composite(**specs, shape=agents), shape=agents[:1])

        self.action_spec = of_agents(action=Categorical(2, shape=agents))
        self.observation_spec = of_agents(
            observation=Unbounded(torch.Size([*agents, 3])),
            adjacency=Binary(self.n_agents, pairs, dtype=torch.bool),
            distance_rank=Bounded(0, self.n_agents - 1, pairs, dtype=torch.int64),
            own_reward=Unbounded(torch.Size([*agents, 1])),
        )
        self.reward_spec = of_agents(reward=Unbounded(torch.Size([*agents, 1])))
        self.done_spec = Composite({key: flag.clone() for key in keys.ENDINGS}, shape=agents[:1])
        self.to(self.device)

    @property
    def episode_seeds(self) -> Int[Tensor, " env"]:
        """The numbers that tell the present episodes apart: leader and bit of each."""
        return 2 * self.leader + self.bit

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        resets = torch.ones_like(self.step_count, dtype=torch.bool)
        if mask is not None:
            resets = mask.view(-1)
        self.episode = self.episode + resets
        self.step_count = self.step_count.masked_fill(resets, 0)
        return self._frame(torch.zeros((*self.batch_size, self.n_agents), device=self.device))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get(keys.ACTION)
        right = action == self.bit[:, None]
        earned = torch.where(right, 1.0, -1.0).masked_fill(self.leads, 0.0)
        self.step_count = self.step_count + 1
        frame = self._frame(earned)
        return frame.set(keys.REWARD, earned.unsqueeze(-1).clone())

    @property
    def leader(self) -> Int[Tensor, " env"]:
        """The robot that leads the present episode of each world."""
        words = (self.env_index, self.episode, Purpose.START)
        return random_below(self.n_agents, self.seed_in_use, *words)

    @property
    def bit(self) -> Int[Tensor, " env"]:
        """What the leader of each world sees."""
        return random_below(2, self.seed_in_use, self.env_index, self.episode, Purpose.PLACE)

    @property
    def leads(self) -> Bool[Tensor, "env agent"]:
        """Which robots lead."""
        return torch.arange(self.n_agents, device=self.device) == self.leader[:, None]

    def _frame(self, earned: Tensor) -> TensorDict:
        bit = torch.stack([self.bit == 0, self.bit == 1], -1)[:, None]
        seen = torch.cat([self.leads.unsqueeze(-1), self.leads.unsqueeze(-1) & bit], -1)
        entries = {"observation": seen.float(), "own_reward": earned.unsqueeze(-1), **self.graph}
        over = (self.step_count >= self.max_steps).unsqueeze(-1)
        flags = {
            keys.DONE: over,
            keys.TERMINATED: over.clone(),
            keys.TRUNCATED: torch.zeros_like(over),
        }
        agents = TensorDict(entries, [*self.batch_size, self.n_agents], device=self.device)
        return TensorDict({keys.AGENTS: agents, **flags}, self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Fix everything that is drawn; the next reset starts episode 0 of this seed."""
        if seed is None:
            raise BadInput("seed=None: must be an integer")
        self.seed_in_use = seed
        self.episode = torch.full_like(self.env_index, -1)
        self.step_count = torch.zeros_like(self.env_index)

    def state_dict(self, *args: Any, **kwargs: Any) -> OrderedDict[str, Tensor]:
        """Return the seed, and each world's episode and step: all else follows from them."""
        return OrderedDict(
            seed=torch.tensor(self.seed_in_use),
            episode=self.episode.clone(),
            step_count=self.step_count.clone(),
        )

    def load_state_dict(self, state_dict: Mapping[str, Tensor], *args: Any, **kwargs: Any) -> None:
        """Restore exactly the state that `state_dict` returned.

        Raises:
            BadInput: the state has another number of worlds.
        """
        if state_dict["episode"].shape != self.episode.shape:
            raise BadInput("env state: sizes differ from this env's; same config needed")
        self.seed_in_use = int(state_dict["seed"])
        self.episode = state_dict["episode"].to(self.device, copy=True)
        self.step_count = state_dict["step_count"].to(self.device, copy=True)
