"""Convolutions, then fully connected layers: the encoder of square observations."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from marl_clean.encoder._convolved import check_strides, side_after
from marl_clean.encoder.base import Encoder, connect
from marl_clean.errors import BadInput
from marl_clean.settings import (
    Form,
    Layers,
    NonNegativeInt,
    Norm,
    PositiveInt,
    Probability,
    Recurrence,
)

Spread = Callable[[Tensor], Tensor]
"""Spreads observations `[*batch, channel, row, col]` over more planes."""


class ConvolutionOfOneCell(nn.Conv2d):
    """A convolution in float32, on a CPU also where those around it are in bfloat16.

    For images of one cell: there torch's gradients in bfloat16 are memory that nothing was written
    to, up to 3e38, and other numbers in the next run.
    """

    def forward(self, input: Float[Tensor, "square channel 1 1"]) -> Float[Tensor, "..."]:
        if input.device.type != "cpu":
            return super().forward(input)
        with torch.autocast("cpu", enabled=False):
            return super().forward(input.float())


@final
class Cnn(Encoder):
    """Turn each robot's square of the map into a feature vector (paper §3.4, figure 3).

    Convolutions, each followed by a ReLU, lead into fully connected layers, each followed by a
    ReLU and, if `dropout` is not 0, dropout. All robots share the weights.

    Args:
        observation_shape: (channel, rows, cols) of one robot's observation.
        channels: output channels of each convolution.
        kernel_size: side of each convolution's window.
        strides: stride of each convolution.
        padding: cells of zeros put around the input of each convolution.
        hidden: width of each fully connected layer; the last is the feature's.
        dropout: share of hidden units dropped while learning.
        planes: spread the observation's codes over planes first, as `spread` does.
        channels_last: memory format of the convolutions; faster on a CPU, the same result.
        memory: `gru`: the features go through a GRU that remembers those of earlier steps.
        norm: `layer`: each fully connected layer is normalised before its ReLU.
        spread: how `planes` spreads codes, as the observation defines it; null: nothing to spread.

    Raises:
        BadInput: lists of different lengths, an observation that is not square or is too small for
            the convolutions.
    """

    takes = Form.SQUARES

    def __init__(
        self,
        observation_shape: torch.Size,
        channels: Layers,
        kernel_size: PositiveInt,
        strides: Layers,
        padding: NonNegativeInt,
        hidden: Layers,
        dropout: Probability,
        planes: bool,
        channels_last: bool,
        memory: Recurrence = "none",
        norm: Norm = "none",
        spread: Spread | None = None,
    ) -> None:
        super().__init__()
        if len(observation_shape) != 3:
            raise BadInput(f"encoder=cnn: takes squares, not {list(observation_shape)}")
        check_strides(channels, strides)
        self.spread = spread if planes else None
        self.memory_format = torch.channels_last if channels_last else torch.contiguous_format
        in_channels, *sides = observation_shape
        if self.spread is not None:
            in_channels = len(self.spread(torch.zeros(observation_shape)))
        depths = pairwise([in_channels, *channels])
        convolutions: list[nn.Module] = []
        left = [side_after(side, kernel_size, strides, padding) for side in sides]
        for index, ((before, after), stride) in enumerate(zip(depths, strides, strict=True)):
            sides_in = [side_after(side, kernel_size, strides[:index], padding) for side in sides]
            kind = ConvolutionOfOneCell if max(sides_in) == 1 else nn.Conv2d
            convolutions += [
                kind(before, after, kernel_size, stride, padding),
                nn.ReLU(inplace=True),
            ]
        self.convolutions = nn.Sequential(*convolutions)
        self.convolutions.to(memory_format=self.memory_format)  # type: ignore[call-overload]
        self.connected = connect([channels[-1] * math.prod(left), *hidden], dropout, norm)
        self.observation_shape = tuple(observation_shape)
        self.out_features = hidden[-1]
        self.remember(memory)

    def forward(
        self, observation: Float[Tensor, "*batch agent channel row col"]
    ) -> Float[Tensor, "*batch agent feature"]:
        """Return one feature vector a robot, from its own observation alone."""
        self.check_shape(observation)
        square = observation.flatten(0, -4)
        if self.spread is not None:
            square = self.spread(square)
        image = self.convolutions(square.contiguous(memory_format=self.memory_format))
        return self.connected(image.flatten(1)).unflatten(0, observation.shape[:-3])
