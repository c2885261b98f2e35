"""The sizes of a stack of convolutions, computed without torch so that checks are fast."""

from collections.abc import Sequence
from itertools import pairwise

from marl_clean.errors import BadInput


def check_strides(channels: Sequence[int], strides: Sequence[int]) -> None:
    """Raises BadInput unless each convolution has one stride."""
    if len(channels) != len(strides):
        raise BadInput(
            f"encoder.strides: {len(strides)} strides for {len(channels)} convolutions;"
            " give one for each of encoder.channels"
        )


def side_after(side: int, kernel_size: int, strides: Sequence[int], padding: int) -> int:
    """The side of a square after convolutions: s' = floor((s + 2 padding - kernel) / stride) + 1.

    Raises BadInput where no cell is left.
    """
    left = side
    for stride in strides:
        left = (left + 2 * padding - kernel_size) // stride + 1
        if left < 1:
            raise BadInput(
                f"encoder.channels: a view of {side} is too small for {len(strides)} convolutions"
                f" of encoder.kernel_size={kernel_size}; use fewer, smaller strides or more padding"
            )
    return left


def fewest_weights(channels: Sequence[int], kernel_size: int) -> int:
    """The weights of convolutions of one input plane, biases included: a lower bound."""
    pairs = pairwise([1, *channels])
    return sum((before * kernel_size**2 + 1) * after for before, after in pairs)
