"""The policy that collects: for a run's first frames a planner, then the learner itself."""

from collections.abc import Mapping

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean import keys
from marl_clean.config.levels import read_level
from marl_clean.config.schema import instantiate
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.learning.agent import Agent
from marl_clean.planner.base import Planner
from marl_clean.settings import StatesOf


class Demonstrator(TensorDictModuleBase):
    """A planner's actions, recorded as demonstrations in every step and taken in a share of them.

    Attributes:
        share: of the steps of a world in which its robots do what the planner does; in the others
            the actions stay that the frame holds.
    """

    def __init__(self, planner: Planner) -> None:
        super().__init__()
        self.planner, self.share = planner, 1.0
        self.in_keys = list(planner.in_keys)
        self.out_keys = [keys.ACTION, keys.DEMONSTRATION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        planned = self.planner.act()
        action = planned.clone()
        if self.share < 1.0:
            draw = torch.rand(planned.shape[:-1], device=planned.device).unsqueeze(-1)
            action = torch.where(draw < self.share, planned, tensordict[keys.ACTION])
        return tensordict.set(keys.ACTION, action).set(keys.DEMONSTRATION, planned)


class Switching(TensorDictModuleBase):
    """Acts by a demonstrating policy at first, by an exploring one afterwards.

    Attributes:
        demonstrates: whether the demonstrating policy acts now.
    """

    def __init__(self, exploring: TensorDictModuleBase, planned: TensorDictModuleBase) -> None:
        super().__init__()
        self.exploring, self.planned, self.demonstrates = exploring, planned, False
        self.in_keys = list(exploring.in_keys)
        self.out_keys = [*exploring.out_keys, keys.DEMONSTRATION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.demonstrates:
            return self.planned(tensordict)
        frame = self.exploring(tensordict)
        return frame.set(keys.DEMONSTRATION, torch.full_like(frame[keys.ACTION], -1))


class WarmStart:
    """Lets a planner act for the first frames of a run; without one the learner always acts.

    In states of the learner the planner acts in a share of the steps that falls from 1 to 0 over
    these frames, and says in all of them what it would do. Source: DAgger, arXiv 1011.0686.

    Args:
        agent: with a planner it also learns from the demonstrations.
        env: the env that the planner plans for.
        imitate: the planner's name; None: there are no demonstrations.
        until: the frames after which there are no demonstrations.
        states: whose states they are of, the planner's or, more and more, the learner's own.

    Attributes:
        policy: the policy of the collector.

    Raises:
        BadInput: a learner that cannot imitate, or an env without houses.
    """

    def __init__(
        self,
        agent: Agent,
        env: EnvBase,
        imitate: str | None,
        until: float,
        states: StatesOf = "planner",
    ) -> None:
        self.until, self.states = until, states
        self.planner: Planner | None = None
        self.policy = exploring = agent.exploration(env.full_action_spec)
        if imitate is None:
            return
        if not isinstance(env.base_env, CleaningEnv):
            raise BadInput(f"trainer.imitate={imitate}: planners need houses; valid: null")
        planner = instantiate(DictConfig(read_level("planner", imitate)))
        self.planner = planner.bind(env.base_env)
        agent.demonstrated = True
        self.demonstrator = Demonstrator(planner)
        planned = agent.demonstrated_by(self.demonstrator, env.full_action_spec)
        self.policy = Switching(exploring, planned)

    def at(self, frames: int) -> None:
        """Choose the policy that acts after this number of frames."""
        if isinstance(self.policy, Switching):
            self.policy.demonstrates = frames < self.until
            if self.policy.demonstrates and self.states == "learner":
                self.demonstrator.share = 1.0 - frames / self.until

    def state(self) -> dict[str, Tensor]:
        """Return the planner's memory."""
        return {} if self.planner is None else self.planner.memory()

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Resume from `state`."""
        if self.planner is not None and state:
            self.planner.restore(state)
