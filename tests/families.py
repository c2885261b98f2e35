"""Families of cases: `make test` runs them all, `make test-fast` a few of each."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

OF_PRIVATE_MAPS = ("autoencoder", "delta", "lend", "patch")


def world_for(scheme: str) -> list[str]:
    """Return the settings that a scheme needs of the world."""
    return ["env.memory=private"] if scheme in OF_PRIVATE_MAPS else []


def family(
    names: str | tuple[str, ...], cases: Iterable[Any], fast: int | Collection[Any] = 3, **ids: Any
) -> pytest.MarkDecorator:
    """Parametrize a test; all cases are slow but those in `fast`, or as many as it says.

    A number of cases is spread over the family, since neighbours tend to be alike.
    """
    listed = list(cases)
    if isinstance(fast, int):
        step = max(1, len(listed) // fast)
        fast = listed[::step][:fast]
    single = isinstance(names, str)
    marked = [
        case if case in fast else pytest.param(*[case] if single else case, marks=pytest.mark.slow)
        for case in listed
    ]
    return pytest.mark.parametrize(names, marked, **ids)
