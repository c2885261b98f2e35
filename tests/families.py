"""Families of cases: `make test-all` runs them all, the other targets some of each."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

OF_PRIVATE_MAPS = ("autoencoder", "delta", "lend", "patch")


def world_for(scheme: str) -> list[str]:
    """Return the settings that a scheme needs of the world."""
    return ["env.memory=private"] if scheme in OF_PRIVATE_MAPS else []


def family(
    names: str | tuple[str, ...],
    cases: Iterable[Any],
    fast: int | Collection[Any] = 3,
    usual: int | Collection[Any] | None = None,
    **ids: Any,
) -> pytest.MarkDecorator:
    """Parametrize a test: all cases are slow but those in `fast`, or as many as it says.

    With `usual`, `make test` runs these alone, and all others are marked `long`. A number of cases
    is spread over the family, since neighbours tend to be alike.
    """
    listed = list(cases)
    fast = _spread(listed, fast)
    usual = listed if usual is None else [*fast, *_spread(listed, usual)]
    single = isinstance(names, str)

    def marked(case: Any) -> Any:
        mark = pytest.mark.slow if case in usual else pytest.mark.long
        return case if case in fast else pytest.param(*[case] if single else case, marks=mark)

    return pytest.mark.parametrize(names, [marked(case) for case in listed], **ids)


def _spread(cases: list[Any], chosen: int | Collection[Any]) -> Collection[Any]:
    """Return the cases chosen, or as many of them as a number says."""
    if not isinstance(chosen, int):
        return chosen
    return cases[:: max(1, len(cases) // chosen)][:chosen]
