"""All loggers of a training as one, and what they have logged as a part of its state."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack

import torch
from torch import Tensor

from marl_clean.logger.base import Logger


class Loggers:
    """Passes rows on to every logger of a training, until they are closed."""

    def __init__(self, loggers: Iterable[Logger]) -> None:
        self.open = list(loggers)

    def resume(self, frames: int, state: Mapping[str, Tensor]) -> None:
        """Go on after `frames`, with what was logged until then."""
        for logger in self.open:
            if (logged := state.get(type(logger).__name__)) is not None:
                logger.restore(logged.numpy().tobytes().decode())
            logger.resume(frames)

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        for logger in self.open:
            logger.log(frames, values)

    def state(self) -> dict[str, Tensor]:
        """Return what was logged, by the loggers' classes.

        As bytes, since the JSON of a state is bounded and a log is not.
        """
        texts = {type(logger).__name__: logger.state().encode() for logger in self.open}
        return {
            name: torch.frombuffer(bytearray(text), dtype=torch.uint8)
            for name, text in texts.items()
            if text
        }

    def close(self) -> None:
        """Put all rows on the disk, once: every logger's, even where another's cannot be."""
        with ExitStack() as stack:
            while self.open:
                stack.callback(self.open.pop().close)
