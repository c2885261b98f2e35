"""Who acts while a run collects: for its first frames a planner, then the learner itself."""

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


class Demonstrator(TensorDictModuleBase):
    """A planner's actions, written down as what was shown, too."""

    def __init__(self, planner: Planner) -> None:
        super().__init__()
        self.planner = planner
        self.in_keys = list(planner.in_keys)
        self.out_keys = [keys.ACTION, keys.DEMONSTRATION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = self.planner.act()
        return tensordict.set(keys.ACTION, action).set(keys.DEMONSTRATION, action.clone())


class Turns(TensorDictModuleBase):
    """Acts by one policy while a planner shows, by another afterwards.

    Attributes:
        shows: whether the planner acts now.
    """

    def __init__(self, exploring: TensorDictModuleBase, showing: TensorDictModuleBase) -> None:
        super().__init__()
        self.exploring, self.showing, self.shows = exploring, showing, False
        self.in_keys = list(exploring.in_keys)
        self.out_keys = [*exploring.out_keys, keys.DEMONSTRATION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.shows:
            return self.showing(tensordict)
        frame = self.exploring(tensordict)
        return frame.set(keys.DEMONSTRATION, torch.full_like(frame[keys.ACTION], -1))


class WarmStart:
    """Lets a planner act for the first frames of a run; without one the learner always acts.

    Args:
        agent: with a planner it learns from what is shown, too.
        env: whose houses the planner plans for.
        imitate: the planner's name; None: nobody shows anything.
        until: the frames after which the learner acts itself.

    Attributes:
        policy: what collects.

    Raises:
        BadInput: a learner that cannot, or an env without houses.
    """

    def __init__(self, agent: Agent, env: EnvBase, imitate: str | None, until: float) -> None:
        self.until = until
        self.planner: Planner | None = None
        self.policy = exploring = agent.exploration(env.full_action_spec)
        if imitate is None:
            return
        if not isinstance(env.base_env, CleaningEnv):
            raise BadInput(f"trainer.imitate={imitate}: planners need houses; valid: null")
        planner = instantiate(DictConfig(read_level("planner", imitate)))
        self.planner = planner.bind(env.base_env)
        agent.demonstrated = True
        showing = agent.demonstrated_by(Demonstrator(planner), env.full_action_spec)
        self.policy = Turns(exploring, showing)

    def at(self, frames: int) -> None:
        """Let the one act whose turn it is after so many frames."""
        if isinstance(self.policy, Turns):
            self.policy.shows = frames < self.until

    def state(self) -> dict[str, Tensor]:
        """Return what the planner remembers."""
        return {} if self.planner is None else self.planner.memory()

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Go on from `state`."""
        if self.planner is not None and state:
            self.planner.restore(state)
