"""Random draws that are pure functions of what they are for.

A draw depends on (seed, env index, episode, purpose, counter) and on nothing else, so env i of 64
draws what env i draws alone, a partial reset disturbs no other, and there is no generator to save.
"""

from enum import IntEnum
from typing import Any

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.world.state import State

_LOW_32_BITS = 0xFFFFFFFF

Seed = int | Int[Tensor, ""]
"""A number of up to 64 bits, or what `seed_tensor` makes of it for compiled functions."""


class Purpose(IntEnum):
    """What a draw is for; streams of different purposes are independent."""

    HOUSE = 1
    START = 2
    FURNITURE = 3
    ACTION = 4
    BUMP = 5
    PLACE = 6
    CHANNEL = 7
    SPILL = 8


def seed_tensor(seed: int, device: torch.device) -> Int[Tensor, ""]:
    """Return a seed in the form in which it may differ from call to call of a compiled function.

    Hashed already, because what compiling takes grows steeply with the hashes in a row.
    """
    return torch.tensor(_hash_of_seed(seed), device=device)


def _hash_of_seed(seed: int) -> int:
    return _mix(_mix(seed & _LOW_32_BITS) ^ (seed >> 32 & _LOW_32_BITS))


def _mix(word: Any) -> Any:
    """Bijective finaliser of 32-bit words, int or tensor: xor-shifts and odd multiplications.

    Constants: "lowbias32", C. Wellons, "Prospecting for hash functions" (2018).
    """
    word = word ^ (word >> 16)
    word = (word * 0x7FEB352D) & _LOW_32_BITS
    word = word ^ (word >> 15)
    word = (word * 0x846CA68B) & _LOW_32_BITS
    return word ^ (word >> 16)


def random_bits(seed: Seed, *words: int | Tensor) -> Int[Tensor, "..."]:
    """Hash a seed of up to 64 bits and words of up to 32 bits to int64 values in [0, 2^32).

    The words broadcast against each other; at least one of them is a tensor.
    """
    state = seed if isinstance(seed, Tensor) else _hash_of_seed(seed)
    for word in words:
        state = _mix(state ^ word)
    return torch.as_tensor(state)


def random_below(bound: int | Tensor, seed: Seed, *words: int | Tensor) -> Int[Tensor, "..."]:
    """Draw int64 values in [0, bound), bound at most 2^31; the bias is below bound / 2^32."""
    return (random_bits(seed, *words) * bound) >> 32


def words_of_robots(
    state: State, env_index: Int[Tensor, " env"], purpose: Purpose
) -> tuple[Tensor, Tensor, Purpose, Tensor, Tensor]:
    """Return the words of a draw for each robot and step, `[env, agent]` when broadcast."""
    robot = torch.arange(state.n_agents, device=env_index.device)
    return env_index[:, None], state.episode[:, None], purpose, state.step[:, None], robot


def happens(probability: float, seed: Seed, *words: int | Tensor) -> Bool[Tensor, "..."]:
    """Draw true with a probability, up to 2^-33."""
    return random_bits(seed, *words) < round(probability * 2**32)
