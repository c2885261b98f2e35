"""What the encoders share."""

from collections.abc import Sequence
from itertools import pairwise

from torch import nn


def connect(widths: Sequence[int], dropout: float) -> nn.Sequential:
    """Return fully connected layers from widths[0] to widths[-1].

    Each is followed by a ReLU and, if asked for, dropout.
    """
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU(inplace=True)]
        layers += [nn.Dropout(dropout)] if dropout else []
    return nn.Sequential(*layers)
