"""Schedules over a run: step sizes, discounts, and the share of random actions."""

from tensordict import NestedKey
from torch.optim import Optimizer
from torchrl.data import Composite
from torchrl.modules import EGreedyModule

from marl_clean.settings import RisesWith


def linear(start: float, end: float, progress: float) -> float:
    """Interpolate linearly from start to end by a run's `progress`, from 0 to 1."""
    return start + min(1.0, progress) * (end - start)


def set_step_size(optimiser: Optimizer, lr: float) -> None:
    """Set an optimiser's step size, in place."""
    for group in optimiser.param_groups:
        group["lr"] = lr


class Discount:
    """A discount that moves from `gamma` to `gamma_end`, if there is one.

    It moves with the run's progress, or with the share of recent episodes that were finished: a
    robot that cleans its houses can look further ahead. Source: arXiv 2403.12856.
    """

    def __init__(self, gamma: float, gamma_end: float | None, rises_with: RisesWith) -> None:
        self.gamma, self.gamma_end, self.rises_with = gamma, gamma_end, rises_with

    def at(self, progress: float, finished: float) -> float:
        """Return the discount at this progress and share of recent episodes finished."""
        if self.gamma_end is None:
            return self.gamma
        share = progress if self.rises_with == "progress" else finished
        return linear(self.gamma, self.gamma_end, share)


class Epsilon:
    """The share of random actions, which falls linearly over a fraction of a run and stays.

    Source: paper §3.4.

    Attributes:
        now: the present share.
    """

    def __init__(self, eps_init: float, eps_end: float, annealing_fraction: float) -> None:
        self.eps_init, self.eps_end, self.fraction = eps_init, eps_end, annealing_fraction
        self._coins: list[EGreedyModule] = []
        self.anneal(0.0)

    def anneal(self, progress: float) -> None:
        """Set the share by a run's `progress`, from 0 to 1."""
        share = progress / self.fraction if self.fraction else 1.0
        self.now = linear(self.eps_init, self.eps_end, share)
        for coin in self._coins:  # their own step() loops over frames in Python
            coin.eps.fill_(self.now)

    def coin(
        self, action_spec: Composite, action_key: NestedKey, mask_key: NestedKey | None = None
    ) -> EGreedyModule:
        """Return TorchRL's epsilon-greedy module, whose epsilon follows `anneal`.

        It explores only under TorchRL's `ExplorationType.RANDOM`, as a Collector sets it. With
        `mask_key` it draws from the actions that the frame's mask under this key allows.
        """
        coin = EGreedyModule(
            action_spec.clone(),  # it writes masks into it
            action_key=action_key,
            action_mask_key=mask_key,
            device=action_spec.device,
        )
        coin.eps.fill_(self.now)
        self._coins.append(coin)
        return coin
