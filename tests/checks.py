"""Shapes and types in annotations are checked at run time, sparingly.

In each test, of every function the first calls and then a share of the others: in a loop over
steps they are the same check over and over, which took as long as all that the tests do.
"""

import inspect
from collections import Counter
from collections.abc import Callable
from functools import partial, wraps
from types import CodeType
from typing import Any

import jaxtyping
from jaxtyping import config, install_import_hook, jaxtyped

FIRST, ONE_IN = 6, 50
calls: Counter[CodeType] = Counter()
"""The calls of every function since the test began."""


def install() -> None:
    """Let all modules of the package that are imported from now on be checked."""
    jaxtyping.jaxtyped = sparingly  # what the hook decorates functions with
    install_import_hook("marl_clean", "beartype.beartype")


def sparingly(function: Any = None, *, typechecker: Callable) -> Any:
    """`jaxtyped`, but only some calls are checked, and nothing is prepared before the first is."""
    if function is None:
        return partial(sparingly, typechecker=typechecker)
    if not inspect.isfunction(function):
        return jaxtyped(function, typechecker=typechecker)
    code, checked = function.__code__, None

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        __tracebackhide__ = True
        if config.jaxtyping_disable:
            return function(*args, **kwargs)
        calls[code] += 1
        if calls[code] > FIRST and calls[code] % ONE_IN:
            return function(*args, **kwargs)
        if checked is None:
            checked = jaxtyped(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    return call
