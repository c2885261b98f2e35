"""State values for policy-gradient learners; used in learning alone."""

import copy
from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import PopArtValueNorm

from marl_clean import keys
from marl_clean.encoder.base import Encoder
from marl_clean.learning.arithmetic import reduced_for
from marl_clean.settings import Precision, Recurrence

Knows = Literal["local", "robots", "state"]
POOLED = 4  # side of the pooled true state, whatever the house's size
STATE_CHANNELS = (16, 32)


class StateEncoder(nn.Module):
    """Features of a house's true state, whatever its size: convolutions, max-pooled to 4 x 4."""

    def __init__(self, planes: int, width: int) -> None:
        super().__init__()
        first, second = STATE_CHANNELS
        self.convolutions = nn.Sequential(
            nn.Conv2d(planes, first, 3, stride=1, padding=1),
            nn.ReLU(),
            nn.Conv2d(first, second, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AdaptiveMaxPool2d(POOLED),
        )
        self.connected = nn.Sequential(nn.Linear(second * POOLED**2, width), nn.ReLU())

    def forward(
        self, state: Bool[Tensor, "*batch plane row col"]
    ) -> Float[Tensor, "*batch feature"]:
        planes = state.flatten(0, -4).float()
        return self.connected(self.convolutions(planes).flatten(1)).unflatten(0, state.shape[:-3])


class Unrolled(NamedTuple):
    """A critic's values of consecutive frames.

    Attributes:
        value: `[env, time, n, 1]`.
        before, after: its memory before and after each frame, `[env, time, n, d]`.
    """

    value: Tensor
    before: Tensor
    after: Tensor


class Critic(nn.Module):
    """The value of every robot's state.

        local:  V_i = head(relu(W h_i)),                                   h_i = encoder(o_i)
        robots: V_i = head(relu(W [h_i, mean over all robots j of h_j]))
        state:  V_i = head(relu(W [h_i, g(s)])),                           s the true state

    It has its own encoder and does not communicate; it works for any number of robots and size of
    house. With `memory=gru` the argument of W goes through a GRU of its own first. With
    `normalises` the head returns values less their running mean, over their running deviation:
    what is far ahead then counts as numbers of the size that networks are initialised for. Source:
    arXiv 2103.01955, section 5.1.
    """

    def __init__(
        self,
        encoder: Encoder,
        knows: Knows,
        precision: Precision,
        memory: Recurrence = "none",
        state_shape: torch.Size | None = None,
        normalises: bool = False,
    ) -> None:
        super().__init__()
        self.encoder, self.knows = _fresh(encoder), knows
        self.precision: Precision = precision
        width = encoder.out_features
        joined = width if knows == "local" else 2 * width
        self.head = nn.Sequential(nn.Linear(joined, width), nn.ReLU(), nn.Linear(width, 1))
        self.memory = nn.GRUCell(joined, joined) if memory == "gru" else None
        self.norm = PopArtValueNorm(shape=1) if normalises else None
        if knows == "state":
            assert state_shape is not None
            self.state = StateEncoder(state_shape[0], width)
        state = (keys.STATE,) if knows == "state" else ()
        self.sees: tuple[NestedKey, ...] = (keys.OBSERVATION, *state)

    def forward(
        self,
        observation: Float[Tensor, "..."],
        state: Bool[Tensor, "*batch plane row col"] | None = None,
    ) -> Float[Tensor, "*batch agent 1"]:
        """Return values without a memory."""
        return self.value(self.features(observation, state))

    def value(self, feature: Float[Tensor, "*batch joined"]) -> Float[Tensor, "*batch 1"]:
        """Return the values of states with these features, in units of the reward."""
        value = self.head(feature)
        return value if self.norm is None else self.norm.denormalize(value)

    def features(
        self,
        observation: Float[Tensor, "..."],
        state: Bool[Tensor, "*batch plane row col"] | None = None,
    ) -> Float[Tensor, "*batch agent joined"]:
        """Return the features of each robot's state, before memory and head."""
        with reduced_for(observation, self.precision):
            feature = self.encoder(observation)
        feature = feature.float()
        if self.knows == "local":
            return feature
        if state is not None:
            other = self.state(state).unsqueeze(-2).expand_as(feature)
        else:
            other = feature.mean(-2, keepdim=True).expand_as(feature)
        return torch.cat([feature, other], dim=-1)

    def remember(
        self, feature: Float[Tensor, "*batch agent joined"], hidden: Tensor
    ) -> Float[Tensor, "*batch agent joined"]:
        """Return the memory after a frame."""
        assert self.memory is not None
        after = self.memory(feature.flatten(0, -2), hidden.flatten(0, -2))
        return after.unflatten(0, feature.shape[:-1])

    def unroll(self, frames: TensorDictBase, hidden: Tensor) -> Unrolled:
        """Return values over frames `[env, time]`; the memory is zeros where an episode begins."""
        feature = self.features(*(frames[key] for key in self.sees))
        begins = frames[keys.IS_INIT]
        before, after = [], []
        for t in range(feature.shape[1]):
            hidden = torch.where(begins[:, t, :, None], 0.0, hidden)
            before.append(hidden)
            hidden = self.remember(feature[:, t], hidden)
            after.append(hidden)
        remembered = torch.stack(after, dim=1)
        return Unrolled(self.value(remembered), torch.stack(before, dim=1), remembered)

    def no_memory(self, frames: TensorDictBase) -> Float[Tensor, "env agent joined"]:
        """Return the zero memory at the start of an episode, for frames `[env, time]`."""
        assert self.memory is not None
        shape = frames[keys.ACTION].shape
        return torch.zeros(shape[0], shape[-1], self.memory.hidden_size, device=frames.device)


class Values(TensorDictModuleBase):
    """The critic as the module that TorchRL's losses expect."""

    def __init__(self, critic: Critic) -> None:
        super().__init__()
        self.critic = critic
        remembered = (keys.CRITIC_HIDDEN, keys.IS_INIT) if critic.memory is not None else ()
        self.in_keys = [*critic.sees, *remembered]
        self.out_keys = [keys.STATE_VALUE]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.critic.memory is None:
            value = self.critic(*(tensordict.get(key) for key in self.critic.sees))
        else:
            value = self.critic.unroll(tensordict, tensordict.get(keys.CRITIC_HIDDEN)[:, 0]).value
        return tensordict.set(keys.STATE_VALUE, value)


def _fresh(encoder: Encoder) -> Encoder:
    """Return an encoder of the same kind with weights of its own, newly drawn, and no memory."""
    other = copy.deepcopy(encoder)
    other.memory = None
    for module in other.modules():
        if isinstance(module, nn.Linear | nn.Conv2d):
            module.reset_parameters()
    return other
