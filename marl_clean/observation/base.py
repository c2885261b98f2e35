"""What a robot sees, as a transform (paper §3.2)."""

from abc import abstractmethod
from typing import ClassVar

import torch
from jaxtyping import Float
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.settings import Form
from marl_clean.world.rules import BLOCKED_VALUE, ROBOT_VALUE


class Observation(WorldTransform):
    """Adds `("agents", "observation")`, float32 `[*B, n, ...]`.

    Attributes:
        gives: the form of one robot's observation, which the encoder must take.
        lowest: its least value; the greatest is 1.
        reach_cells: cells around the house that `read` needs in every matrix.
    """

    gives: ClassVar[Form]
    lowest: ClassVar[float] = BLOCKED_VALUE
    reach_cells: int = 1

    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Return the shape of one robot's observation."""

    @staticmethod
    def spread(observation: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Return observations as an encoder takes them: codes spread over planes, if any.

        Frames store the observation itself, which may be more compact. A static method, so that
        networks which hold it can be copied.
        """
        return observation

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, *self.shape()])
        return {keys.OBSERVATION: Bounded(self.lowest, ROBOT_VALUE, shape, device=env.device)}
