"""Means of what learning measures, for a row of the log."""

from collections.abc import Mapping

import torch
from torch import Tensor


class Tally:
    """Sums of measures and how often each was taken, kept as tensors until a row is due."""

    def __init__(self) -> None:
        self.sums: dict[str, Tensor] = {}
        self.counts: dict[str, Tensor] = {}

    def add(self, name: str, values: Tensor, where: Tensor | None = None) -> None:
        """Take all `values`, or those that a mask of the same shape picks."""
        chosen = torch.ones_like(values, dtype=torch.bool) if where is None else where
        total = torch.where(chosen, values, 0).sum(dtype=torch.float64)
        self.sums[name] = self.sums.get(name, 0) + total
        self.counts[name] = self.counts.get(name, 0) + chosen.sum()

    def means(self) -> dict[str, float]:
        """Return the mean of each measure that was taken at all, and begin anew."""
        counts = {name: int(count) for name, count in self.counts.items()}
        means = {name: float(self.sums[name]) / count for name, count in counts.items() if count}
        self.sums, self.counts = {}, {}
        return means

    def state(self) -> dict[str, dict[str, Tensor]]:
        return {"sums": self.sums, "counts": self.counts}

    def restore(self, state: Mapping[str, dict[str, Tensor]]) -> None:
        self.sums, self.counts = state["sums"], state["counts"]
