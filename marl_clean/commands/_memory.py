"""Whether this machine has the memory that a config needs at the least.

What is counted is what robots see, one tensor at a time: a part of what will be used.
"""

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass

from omegaconf import DictConfig

from marl_clean.config.compose import has_houses
from marl_clean.errors import BadInput

FLOAT_BYTES = 4
UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB")


@dataclass(frozen=True)
class Need:
    """A setting, what it is the number of, and the bytes that `power` of it takes.

    Attributes:
        bytes_each: of `value ** power`, so that half of a side needs a quarter.
    """

    key: str
    value: int
    what: str
    bytes_each: int
    power: int = 1

    @property
    def bytes(self) -> int:
        return self.value**self.power * self.bytes_each

    def most(self, memory: int) -> int:
        """The largest value that fits into the memory."""
        fitting = memory // self.bytes_each
        return math.isqrt(fitting) if self.power == 2 else fitting


def check_memory(config: DictConfig, training: bool) -> None:
    """Raises BadInput where a setting needs more memory than this machine has.

    Only what is held in the machine's own memory is counted, not that of a GPU.
    """
    if config.device != "cpu":
        return
    memory = memory_bytes()
    for need in needs(config, training):
        if need.bytes > memory:
            raise BadInput(
                f"{need.key}={need.value}: {need.what} takes {in_words(need.bytes)} or more, of"
                f" {in_words(memory)} on this machine; valid: at most {need.most(memory)}"
            )


def needs(config: DictConfig, training: bool) -> Iterator[Need]:
    """What takes memory in proportion to a setting, at the least."""
    robots, entries = config.env.n_agents if "n_agents" in config.env else 1, 1
    worlds = config.env.num_envs if training else 1
    for side in ("view_size", "largest_side") if has_houses(config) else ():
        if side in config.observation:
            planes = config.observation.get("scales", 1)
            seen = worlds * robots * planes * FLOAT_BYTES
            value = config.observation[side]
            yield Need(f"observation.{side}", value, "what all robots see", seen, power=2)
            entries = value**2 * planes
    if not training:
        return
    frame = robots * entries * FLOAT_BYTES
    for key in ("frames_per_batch", "buffer_frames"):
        if key in config.trainer:
            yield Need(f"trainer.{key}", config.trainer[key], "what they hold", frame)


def memory_bytes() -> int:
    """The memory of this machine."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def in_words(number: int) -> str:
    """A number of bytes in the unit that makes it short."""
    power = min(int(math.log(max(number, 1), 1000)), len(UNITS) - 1)
    return f"{number / 1000**power:.3g} {UNITS[power]}"
