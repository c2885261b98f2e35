"""Fully connected layers: the encoder of vector observations."""

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from marl_clean.encoder.base import Encoder, connect
from marl_clean.errors import BadInput
from marl_clean.settings import Form, Layers, Norm, Probability, Recurrence


@final
class Mlp(Encoder):
    """Turn each robot's vector, such as its sensors' distances, into a feature vector.

    Fully connected layers, each followed by a ReLU and, if `dropout` is not 0, dropout. All robots
    share the weights.

    Args:
        observation_shape: (entries,) of one robot's observation.
        hidden: width of each layer; the last is the feature's.
        dropout: share of hidden units dropped while learning.
        memory: `gru`: the features go through a GRU that remembers those of earlier steps.
        norm: `layer`: each fully connected layer is normalised before its ReLU.

    Raises:
        BadInput: one robot's observation is not a vector.
    """

    takes = Form.VECTOR

    def __init__(
        self,
        observation_shape: torch.Size,
        hidden: Layers,
        dropout: Probability,
        memory: Recurrence = "none",
        norm: Norm = "none",
    ) -> None:
        super().__init__()
        if len(observation_shape) != 1:
            raise BadInput(f"encoder=mlp: takes a vector, not {list(observation_shape)}")
        self.connected = connect([observation_shape[0], *hidden], dropout, norm)
        self.observation_shape = tuple(observation_shape)
        self.out_features = hidden[-1]
        self.remember(memory)

    def forward(
        self, observation: Float[Tensor, "*batch agent entry"]
    ) -> Float[Tensor, "*batch agent feature"]:
        """Return one feature vector a robot, from its own observation alone."""
        self.check_shape(observation)
        return self.connected(observation)
