"""Which actions lead into no wall that a robot knows of, as a transform."""

import torch
from tensordict.utils import NestedKey
from torchrl.data import Binary, TensorSpec

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.transform import WorldTransform
from marl_clean.world.dynamics import MOVES
from marl_clean.world.sensing import not_known_blocked
from marl_clean.world.setup import Setup
from marl_clean.world.state import State
from marl_clean.world.step import Entries


class KnownWalls(WorldTransform):
    """Adds `("agents", "action_mask")`, bool `[*B, n, 4]`: false towards a wall the robot knows.

    It is computed from the map that the robot reads: shared, or its own. All true for a robot
    whose four neighbours are known blocked, as they may be in a stale map. The mask is for
    policies; the env itself accepts every action.
    """

    along = True

    def read(self, state: State, setup: Setup) -> Entries:
        return {keys.ACTION_MASK: not_known_blocked(state, setup.rules)}

    def specs(self, env: CleaningEnv) -> dict[NestedKey, TensorSpec]:
        shape = torch.Size([env.num_envs, env.n_agents, len(MOVES)])
        mask = Binary(len(MOVES), shape, device=env.device, dtype=torch.bool)
        return {keys.ACTION_MASK: mask}
