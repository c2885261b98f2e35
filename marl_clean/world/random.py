"""Random draws that are pure functions of what they are for.

A draw depends on (seed, env index, episode, purpose, counter) and on nothing else, so env i of 64
plays what env i plays alone, a partial reset disturbs nobody, and there is no generator to save.
"""

from enum import IntEnum

import torch
from jaxtyping import Int
from torch import Tensor

_LOW_32_BITS = 0xFFFFFFFF


class Purpose(IntEnum):
    """What a draw is for; streams of different purposes are independent."""

    HOUSE = 1
    START = 2
    FURNITURE = 3
    ACTION = 4


def _mix(word: Tensor) -> Tensor:
    """Bijective finaliser of 32-bit words: xor-shifts around two odd multiplications.

    Constants: "lowbias32", C. Wellons, "Prospecting for hash functions" (2018).
    """
    word = word ^ (word >> 16)
    word = (word * 0x7FEB352D) & _LOW_32_BITS
    word = word ^ (word >> 15)
    word = (word * 0x846CA68B) & _LOW_32_BITS
    return word ^ (word >> 16)


def random_bits(*words: int | Tensor) -> Int[Tensor, "..."]:
    """Hash integer words, broadcast together, to int64 values in [0, 2^32).

    Each word counts with its low 62 bits. At least one of them is a tensor.
    """
    state: Tensor | int = 0x9E3779B9
    for word in words:
        word = torch.as_tensor(word)
        for part in (word & _LOW_32_BITS, word >> 32):
            state = _mix((state ^ part) & _LOW_32_BITS)
    return torch.as_tensor(state)


def random_below(bound: int | Tensor, *words: int | Tensor) -> Int[Tensor, "..."]:
    """Draw int64 values in [0, bound), bound at most 2^31; the bias is below bound / 2^32."""
    return (random_bits(*words) * bound) >> 32
