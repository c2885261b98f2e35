"""Robots that learn to clean a house together.

    env = marl_clean.make_env(["house=open", "env.n_agents=3"])
    policy = marl_clean.load_policy("runs/NAME")

Importing the package does not import torch; using it does.
"""

from pathlib import Path
from typing import TYPE_CHECKING

__version__ = "0.1.0"
__all__ = ["__version__", "load_policy", "make_env"]

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModule
    from torchrl.envs import EnvBase


def make_env(overrides: list[str] | None = None) -> "EnvBase":
    """The TorchRL env of a config, as `marl-clean train` would build it.

    Raises BadInput on a wrong setting.
    """
    from marl_clean.build import make_env as from_config
    from marl_clean.config.compose import compose_config

    return from_config(compose_config(overrides or []))


def load_policy(run: str | Path) -> "TensorDictModule":
    """The best policy of a run, given by folder or name: observation (and adjacency) to action.

    Raises BadInput when there is no such run or its files do not fit.
    """
    from marl_clean.build import load_policy as from_folder
    from marl_clean.config.stored import find_run

    return from_folder(find_run(str(run)))
