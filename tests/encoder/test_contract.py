"""Every level of conf/encoder holds the contract, and encoders that are nearly right do not."""

import pytest
import torch
from torch import nn

from marl_clean.config.levels import rooms
from marl_clean.encoder.base import Encoder
from marl_clean.settings import Form
from marl_clean.testing import ContractBroken, check_encoder


@pytest.mark.parametrize(("memory", "norm"), [("none", "none"), ("gru", "none"), ("none", "layer")])
@pytest.mark.parametrize("level", rooms()["encoder"])
def test_the_contract(level: str, memory: str, norm: str) -> None:
    check_encoder(level, memory=memory, norm=norm)


class Right(Encoder):
    takes = Form.VECTOR

    def __init__(self, observation_shape: torch.Size) -> None:
        super().__init__()
        self.layer = nn.Linear(observation_shape[0], 6)
        self.out_features = 6
        self.remember("none")

    def forward(self, observation):
        return self.layer(observation).tanh()


class Mixing(Right):
    def forward(self, observation):
        return super().forward(observation - observation.mean(-2, keepdim=True))


class Multiplying(Right):
    def forward(self, observation):
        return super().forward(observation) + 0 * observation.sum()


class OverWorlds(Right):
    def forward(self, observation):
        feature = super().forward(observation)
        if feature.ndim == 3 and len(feature) > 2:
            return feature - feature.mean(0)
        return feature


class Noisy(Right):
    def forward(self, observation):
        return super().forward(observation) + 1e-3 * torch.rand(6)


class Idle(Right):
    def __init__(self, observation_shape):
        super().__init__(observation_shape)
        self.idle = nn.Linear(2, 2)


class ByNumber(Right):
    def forward(self, observation):
        feature = super().forward(observation)
        return feature + torch.arange(feature.shape[-2])[:, None]


class TooShort(Right):
    def forward(self, observation):
        return super().forward(observation)[..., 1:]


@pytest.mark.parametrize(
    ("wrong", "broken"),
    [
        (Mixing, "another observation of robot 1 changes the features of robot 0: at"),
        (Multiplying, "NaN of robot 1 changes the features of robot 0: at"),
        (OverWorlds, "world 0 of 5 has other features alone: at"),
        (Noisy, "changes the features of robot 0"),
        (Idle, "idle.weight gets no gradient"),
        (ByNumber, "robots see the same, but have other features: at"),
        (TooShort, r"gives torch.float32 \[3, 5\] for \[3, 8\]"),
    ],
)
def test_the_contract_refuses(wrong: type[Encoder], broken: str) -> None:
    check_encoder(Right)
    with pytest.raises(ContractBroken, match=f"encoder={wrong.__name__}: .*{broken}"):
        check_encoder(wrong)
