"""The central controller: one network acts for all robots, the paper's approach 1 (§3.4)."""

from typing import final

import torch
from jaxtyping import Float, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.data import Categorical, Composite

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.errors import BadInput
from marl_clean.learning import acting
from marl_clean.learning.agent import Channels
from marl_clean.learning.deep_q import DeepQ
from marl_clean.learning.joint_actions import (
    JointQNetwork,
    decode_joint,
    encode_joint,
    joint_mask,
)
from marl_clean.settings import Precision

MOST_OUTPUTS = 4**5


class GreedyJoint(TensorDictModuleBase):
    """The best of all joint actions, and every robot's part in it."""

    def __init__(
        self, network: JointQNetwork, n_agents: int, num_actions: int, mask_walls: bool
    ) -> None:
        super().__init__()
        self.mask_walls = mask_walls
        self.network, self.n_agents, self.num_actions = network, n_agents, num_actions
        self.in_keys = [keys.OBSERVATION, *([keys.ACTION_MASK] if mask_walls else [])]
        self.out_keys = [
            *([keys.JOINT_ACTION_MASK] if mask_walls else []),
            keys.JOINT_ACTION,
            keys.JOINT_ACTION_VALUE,
            keys.CHOSEN_JOINT_ACTION_VALUE,
            keys.ACTION,
        ]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        seen = tensordict.get(keys.OBSERVATION)
        if (n_agents := seen.shape[tensordict.ndim]) != self.n_agents:
            raise BadInput(
                f"env.n_agents={n_agents}: the policy is of {self.n_agents} robots together;"
                f" give an env of {self.n_agents}"
            )
        allowed = None
        if self.mask_walls:
            allowed = joint_mask(tensordict.get(keys.ACTION_MASK))
            tensordict.set(keys.JOINT_ACTION_MASK, allowed)
        value = self.network(seen, allowed)
        chosen, joint = value.max(-1, keepdim=True)
        joint = joint.squeeze(-1)
        tensordict.set(keys.JOINT_ACTION_VALUE, value)
        tensordict.set(keys.CHOSEN_JOINT_ACTION_VALUE, chosen)
        tensordict.set(keys.JOINT_ACTION, joint)
        tensordict.set(keys.ACTION, decode_joint(joint, self.n_agents, self.num_actions))
        return tensordict


@final
class CentralDqn(DeepQ):
    """One network sees all robots' states and chooses their joint action (paper §3.4, approach 1).

        y = (r_1 + ... + r_n) + gamma^k (1 - terminated) max over a in A_1 x ... x A_n of Q'(o', a)

    The reward is the sum of the robots' own, so `reward=team`; the actions are the 4^n joint ones,
    numbered in base 4 with robot 0 the lowest digit, of which one at random is taken with
    probability epsilon. There is no one to communicate with, so `comm=none`. The loss is in
    `DeepQ.loss`; all else as there.

    Raises:
        BadInput: more than 1,024 joint actions, those of 5 robots; 4,096 would learn nothing in a
            sensible time.
    """

    fits = {
        "comm": ["none"],
        "reward": ["team"],
        "channel": ["perfect"],
        "trainer": ["off_policy"],
    }
    sized_by = ["env.n_agents"]

    network: JointQNetwork

    def make_network(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        channels: Channels,
    ) -> JointQNetwork:
        outputs = self.num_actions**self.n_agents
        if outputs > MOST_OUTPUTS:
            raise BadInput(
                f"env.n_agents={self.n_agents}: agent=central_dqn has {self.num_actions}^n outputs"
                f" and takes at most {MOST_OUTPUTS:,} (5 robots of 4 actions); use agent=iql"
            )
        if encoder.memory is not None:
            raise BadInput("encoder.memory=gru: agent=central_dqn has no memory; valid: none")
        width = comm.out_features
        return JointQNetwork(encoder, width, self.n_agents, self.num_actions, dueling, precision)

    @property
    def sees(self) -> tuple[NestedKey, ...]:
        return (keys.OBSERVATION, *([keys.ACTION_MASK] if self.mask_walls else []))

    def make_greedy(self, records_messages: bool) -> GreedyJoint:
        return GreedyJoint(self.network, self.n_agents, self.num_actions, self.mask_walls)

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy: a random action is a random joint action."""
        return self._acting(action_spec)

    def demonstrated_by(
        self, planner: TensorDictModuleBase, action_spec: Composite
    ) -> TensorDictSequential:
        encode = TensorDictModule(
            lambda action: encode_joint(action, self.num_actions),
            in_keys=[keys.ACTION],
            out_keys=[keys.JOINT_ACTION],
        )
        return self._acting(action_spec, planner, encode)

    def _acting(
        self, action_spec: Composite, *instead: TensorDictModuleBase
    ) -> TensorDictSequential:
        joint = Categorical(self.num_actions**self.n_agents, shape=action_spec.shape)
        spec = Composite({keys.JOINT_ACTION: joint}, shape=action_spec.shape)
        mask = keys.JOINT_ACTION_MASK if self.mask_walls else None
        coin = self.exploring.coin(spec.to(action_spec.device), keys.JOINT_ACTION, mask)
        decode = TensorDictModule(
            lambda chosen: decode_joint(chosen, self.n_agents, self.num_actions),
            in_keys=[keys.JOINT_ACTION],
            out_keys=[keys.ACTION],
        )
        greedy = self.make_greedy(records_messages=False).eval()
        return TensorDictSequential(greedy, *instead, coin, decode)

    def values(
        self, network: JointQNetwork, frames: TensorDictBase
    ) -> Float[Tensor, "*batch joint_action"]:
        mask = joint_mask(frames[keys.ACTION_MASK]) if self.mask_walls else None
        return network(frames[keys.OBSERVATION], mask)

    def action(self, frames: TensorDictBase) -> Int[Tensor, "*batch"]:
        return encode_joint(frames[keys.ACTION], self.num_actions)

    def shown(self, frames: TensorDictBase) -> Int[Tensor, "*batch"]:
        planned = frames[keys.DEMONSTRATION]
        joint = encode_joint(planned.clamp(min=0), self.num_actions)
        return torch.where((planned >= 0).all(-1), joint, -1)

    def reward(self, frames: TensorDictBase) -> Float[Tensor, "*batch 1"]:
        return acting.team_reward(frames)
