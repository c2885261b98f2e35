"""Robots that learn to clean a house together.

    run = marl_clean.train("quick", comm="tarmac", n_agents=3)
    run.evaluate(house="apartment")

Importing the package does not import torch; using it does.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "BadInput",
    "CleaningEnv",
    "Run",
    "Table",
    "__version__",
    "compare",
    "evaluate",
    "headroom",
    "load_policy",
    "make_env",
    "study",
    "train",
    "tune",
    "use_plugins",
]

if TYPE_CHECKING:
    from marl_clean.config.locate import use_plugins
    from marl_clean.env.cleaning import CleaningEnv
    from marl_clean.errors import BadInput
    from marl_clean.python.door import compare, evaluate, load_policy, make_env, train
    from marl_clean.python.experiments import study, tune
    from marl_clean.python.headroom import headroom
    from marl_clean.python.run import Run
    from marl_clean.python.table import Table
else:
    _MODULES = {
        "BadInput": "errors",
        "CleaningEnv": "env.cleaning",
        "Run": "python.run",
        "headroom": "python.headroom",
        "study": "python.experiments",
        "tune": "python.experiments",
        "Table": "python.table",
        "use_plugins": "config.locate",
        **dict.fromkeys(("compare", "evaluate", "load_policy", "make_env", "train"), "python.door"),
    }

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first used."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
