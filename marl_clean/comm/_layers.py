"""Small parts that several schemes are made of."""

from torch import Tensor, nn


def outgoing(feature: Tensor, detach: bool) -> Tensor:
    """Return the features that messages are made of.

    Detached, a receiver's loss does not reach the sender's features; the weights that make the
    message of them, which all robots share, still learn.
    """
    return feature.detach() if detach else feature


def dense(before: int, after: int) -> nn.Sequential:
    """Return a fully connected layer and its ReLU."""
    return nn.Sequential(nn.Linear(before, after), nn.ReLU())
