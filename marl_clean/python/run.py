"""A trained run as an object."""

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from marl_clean import build
from marl_clean.commands.checks import check_device
from marl_clean.config.compose import checked
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import METRICS, RUNS, find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import MEASURED, read_entries
from marl_clean.python.keywords import overrides_of
from marl_clean.python.measuring import config_for_policy, env_of, measure
from marl_clean.python.table import Table
from marl_clean.report.curve import plot_curve
from marl_clean.report.metrics import read_metrics
from marl_clean.report.replay import make_replay

REPLAY = "replay.gif"


class Run:
    """A trained run: what `marl_clean.train` returns, and what the folder of a run holds.

        >>> from marl_clean import Run
        >>> run = Run("approach_2_frontier")  # ships with the package
        >>> run.config.env.n_agents
        2
        >>> run.env(num_envs=8).rollout(5, run.policy).shape
        torch.Size([8, 5])

    Args:
        run: its folder, or its name in runs/ or among those that ship.
        device: the device of its policy; None: the one it was trained on.

    Attributes:
        folder: the folder of the run.
        config: the config it was trained with.

    Raises:
        BadInput: there is no such run, its config is damaged, or the device is not available.
    """

    folder: Path
    config: DictConfig

    def __init__(self, run: str | os.PathLike[str], *, device: str | None = None) -> None:
        self.folder = find_run(str(run))
        self.config = checked(load_config(self.folder))
        self.config.device = self.config.device if device is None else device
        check_device(self.config)

    @cached_property
    def policy(self) -> TensorDictModuleBase:
        """The greedy policy: the best weights on validation houses.

            >>> from marl_clean import Run
            >>> run = Run("approach_2_frontier")
            >>> seen = run.env(num_envs=4).reset()
            >>> run.policy(seen)["agents", "action"].shape
            torch.Size([4, 2])

        Raises:
            BadInput: the run has no whole weights yet.
        """
        return build.load_policy(self.folder).to(self.config.device)

    def env(self, *, num_envs: int | None = None, **settings: Any) -> TransformedEnv:
        """Return the env it was trained in, with what its policy carries.

            >>> from marl_clean import Run
            >>> env = Run("approach_2_frontier").env(num_envs=2, house="apartment")
            >>> env.batch_size
            torch.Size([2])

        Settings may change the world around the policy. Raises BadInput where they do not fit it.
        """
        changes = settings if num_envs is None else {"num_envs": num_envs, **settings}
        return env_of(self._overrides(changes))

    def evaluate(
        self, *, intervention: str | Sequence[str] | None = None, **settings: Any
    ) -> Table:
        """Measure its policy beside the planners; see `marl_clean.evaluate`.

            >>> from marl_clean import Run
            >>> table = Run("mine").evaluate(house="apartment", houses=2, max_steps=30)
            >>> table[0]["policy"], table[0]["house_set"]
            ('mine', 'apartment')

        Raises:
            BadInput: what `marl-clean evaluate checkpoint=` refuses, in the same words.
        """
        return measure(self._overrides(settings), intervention)

    @property
    def table(self) -> Table:
        """What was measured when training ended. Raises BadInput before that.

        >>> from marl_clean import Run
        >>> [row["policy"] for row in Run("mine").table][:2]
        ['mine', 'random']
        """
        self._needs(MEASURED, "train it to its end, or call evaluate()")
        return Table(read_entries(self.folder / MEASURED))

    def curve(self) -> Figure:
        """Return the learning curve as a Matplotlib figure; notebooks show it.

            >>> from marl_clean import Run
            >>> Run("mine").curve().savefig("curve.png")

        Raises:
            BadInput: nothing has been logged yet, or the run has no metrics.csv.
        """
        self._needs(METRICS, "the logger csv writes it in training")
        return plot_curve(read_metrics(self.folder / METRICS), {})

    def replay(self, out: str | os.PathLike[str] | None = None, **settings: Any) -> Path:
        """Draw an episode as a GIF and return its path.

            >>> from marl_clean import Run
            >>> path = Run("mine").replay("played.gif", max_steps=5)
            >>> path.name
            'played.gif'

        Without `out` and settings it is the run's own `replay.gif`, drawn where it is missing;
        with settings, `runs/figures/replay-NAME-HASH.gif`.

        Raises:
            BadInput: settings that do not fit the run.
        """
        if out is None and not settings and (self.folder / REPLAY).is_file():
            return self.folder / REPLAY
        config = config_for_policy(self._overrides(settings))
        if out is not None:
            path = Path(out)
        elif settings:
            name = f"replay-{self.config.name}-{config_hash(config)[:8]}.gif"
            path = RUNS / "figures" / name
        else:
            path = self.folder / REPLAY
        make_replay(config, lambda env: self.policy, path, config.evaluation.epsilon)
        return path

    def _needs(self, name: str, remedy: str) -> None:
        """Raises BadInput where the run has no file of this name."""
        if not (self.folder / name).is_file():
            raise BadInput(f"{self.folder}: has no {name}; {remedy}")

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    def _overrides(self, settings: dict[str, Any]) -> list[str]:
        own = {"checkpoint": self.folder, "device": self.config.device}
        return overrides_of(None, {**own, **settings})
