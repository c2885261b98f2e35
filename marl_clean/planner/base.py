"""What scripted policies share: they read the robots' map, never the house."""

from abc import abstractmethod

import torch
from jaxtyping import Int
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.world.random import Purpose, random_below


class Planner(TensorDictModuleBase):
    """A policy for a `CleaningEnv` that is handed over by `bind`; writes `("agents", "action")`."""

    def __init__(self) -> None:
        super().__init__()
        self.in_keys = [keys.POSITION]
        self.out_keys = [keys.ACTION]

    @property
    @abstractmethod
    def label(self) -> str:
        """What the policy is called in tables and `evaluation.json`."""

    def bind(self, env: CleaningEnv) -> "Planner":
        """Plan for the robots of `env` from now on."""
        self.__dict__["env"] = env  # not a submodule: a policy does not own its env
        return self

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict.set(keys.ACTION, self.act())
        return tensordict

    @abstractmethod
    def act(self) -> Int[Tensor, "env agent"]:
        """Return an action for every robot from `self.env.state`."""

    def random_action(self) -> Int[Tensor, "env agent"]:
        """Draw actions that depend on (seed, env, episode, step, robot) alone."""
        env = self.env
        state = env.state
        robot = torch.arange(state.n_agents, device=env.device)
        words = (
            env.env_index,
            state.episode,
            torch.full_like(state.step, Purpose.ACTION),
            state.step,
        )
        return random_below(4, env.seed_in_use, *(word[:, None] for word in words), robot)
