"""Fully connected layers: what an agent makes of a vector it sees."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from marl_clean.settings import Layers, Probability


class Mlp(nn.Module):
    """Turn each agent's vector into a feature vector; all agents share the weights.

    Args:
        observation_shape: (d,) of one agent's observation.
        hidden: width of each layer; the last is the feature's.
        dropout: share of hidden units dropped while learning.
    """

    def __init__(self, observation_shape: torch.Size, hidden: Layers, dropout: Probability) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise([observation_shape.numel(), *hidden]):
            layers += [nn.Linear(before, after), nn.ReLU(inplace=True)]
            layers += [nn.Dropout(dropout)] if dropout else []
        self.layers = nn.Sequential(*layers)
        self.out_features = hidden[-1]

    def forward(
        self, observation: Float[Tensor, "*batch agent width"]
    ) -> Float[Tensor, "*batch agent feature"]:
        """Return one feature vector an agent, from its own observation alone."""
        return self.layers(observation)
