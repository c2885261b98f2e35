"""Independent deep Q-learning with shared weights: the paper's approach 2 (§3.4)."""

from typing import final

from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from marl_clean import keys
from marl_clean.learning.robots_q import RobotsQ


@final
class Iql(RobotsQ):
    """Every robot learns the value of its own actions by deep Q-learning (arXiv 1312.5602).

        y_i = r_i + gamma^k (1 - terminated) Q'(o'_i, argmax_a Q(o'_i, a))
        loss = Huber(Q(o_i, a_i) - y_i), mean over frames and robots

    Gradients cross live edges, or with `messages=replayed` do not: see `RobotsQ`. The loss stands
    in `DeepQ.loss`.
    """

    def reward(self, frames: TensorDictBase) -> Float[Tensor, "*batch agent 1"]:
        return frames["next", keys.REWARD]
