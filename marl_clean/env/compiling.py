"""How an env of pure functions is compiled: function by function."""

from collections.abc import Callable
from typing import Any

import torch

from marl_clean.env.base import BatchedEnv

OPTIONS = {
    "reorder_for_locality": False,  # reads put after writes would keep a copy of the map for them
    "size_asserts": False,  # of every tensor at every call; their shapes are guarded already
    # Functions and constants of modules stay as they are: asking at every call took 3 % of a step.
    "guard_filter_fn": torch.compiler.skip_guard_on_globals_unsafe,
}


class Compiling(BatchedEnv):
    """An env whose `compile` compiles the pure functions that it calls by `compiled`."""

    _compiled: dict[Callable, Callable] | None = None
    _compile_kwargs: dict[str, Any]

    def compile(self, *, warmup: int | None = None, **kwargs: Any) -> "Compiling":
        """Compile the pure functions of a step, each on its own, and return the env.

        Not `step_and_maybe_reset` as a whole, as TorchRL does: the number of worlds that reset
        varies from step to step. `kwargs` go to `torch.compile`; there is nothing to warm up.
        """
        self._compiled, self._compile_kwargs = {}, kwargs
        return self

    def compiled(self, function: Callable, *, wide: bool = False) -> Callable:
        """Return the function compiled, once, where the env is; else as it is.

        `wide`: its innermost loops are long, such as those over a view. Loops over the robots of
        a world are short: vectorised on a CPU, `advance_` took six times as long.
        """
        if self._compiled is None:
            return function
        if function not in self._compiled:
            scalar = {} if wide or self.device.type != "cpu" else {"cpp.simdlen": 1}
            # Isolated, or the envs of a process share the eight compilations a function may have.
            kwargs: dict[str, Any] = {"options": {**OPTIONS, **scalar}, "isolate_recompiles": True}
            compiled = torch.compile(function, **{**kwargs, **self._compile_kwargs})
            self._compiled[function] = compiled
        return self._compiled[function]
