"""How many of the episodes that ended of late were finished."""

import torch
from jaxtyping import Bool
from torch import Tensor

WINDOW_EPISODES = 500  # those longer ago count for e^-1 or less


class Successes:
    """The share of late episodes that ended with every cell cleaned, forgetting exponentially.

    Each episode weighs 1 / 500 more than the one before; what was before the first counts as not
    finished.

    Attributes:
        share: from 0 to 1.
    """

    def __init__(self) -> None:
        self.share = 0.0

    def note(self, done: Bool[Tensor, "env time"], finished: Bool[Tensor, "env time"]) -> None:
        """Count the episodes that ended in a block; within it all weigh alike."""
        ended, well = torch.stack([done.sum(), (done & finished).sum()]).tolist()
        if ended:
            kept = (1 - 1 / WINDOW_EPISODES) ** ended
            self.share = kept * self.share + (1 - kept) * well / ended
