"""The error that a broken contract raises, and how a level is checked against its clauses."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

from marl_clean.errors import BadInput

Clause = Callable[[Any], None]
"""One promise of a room: takes the level under test, raises ContractBroken; its docstring's first
line is the promise."""


class ContractBroken(AssertionError):
    """A level does not keep what its room promises: what is broken, and on which numbers."""


def verify(label: str, clauses: Iterable[Clause], subject: Any) -> None:
    """Check a level against every clause, in order.

    Raises:
        ContractBroken: the first clause that does not hold. Any other error of the level, such as
            one of shapes, breaks the clause that raises it. `BadInput` is passed on.
    """
    for clause in clauses:
        try:
            clause(subject)
        except ContractBroken as broken:
            raise ContractBroken(f"{label}: {broken}") from None
        except BadInput:
            raise
        except Exception as error:  # a plugin's code may raise anything
            reason = (str(error).strip() or "no message").splitlines()[0]
            promise = (clause.__doc__ or clause.__name__).splitlines()[0].rstrip(".")
            raise ContractBroken(
                f"{label}: {type(error).__name__} ({reason}) where the contract is: {promise}"
            ) from error


def require(holds: bool | Tensor, broken: str) -> None:
    """Raise ContractBroken(broken) unless it holds; a tensor holds where all of it is true."""
    if not (bool(holds.all()) if isinstance(holds, Tensor) else holds):
        raise ContractBroken(broken)


def require_equal(result: Tensor, expected: Tensor, broken: str) -> None:
    """Raise ContractBroken, with the numbers, unless two tensors are equal to the bit."""
    _require_same_form(result, expected, broken)
    if not torch.equal(result, expected):
        raise ContractBroken(f"{broken}: {_first(result, expected, result != expected)}")


def require_close(
    result: Tensor, expected: Tensor, broken: str, tolerance: float | None = None
) -> None:
    """Raise ContractBroken, with the numbers, unless two tensors are equal up to rounding.

    `tolerance` is absolute; by default it depends on the dtype.
    """
    _require_same_form(result, expected, broken)
    if not result.is_floating_point():
        require_equal(result, expected, broken)
        return
    if tolerance is not None:
        close = torch.isclose(result, expected, rtol=0.0, atol=tolerance)
    elif result.dtype == torch.float64:
        close = torch.isclose(result, expected, rtol=1e-7, atol=1e-7)
    else:
        close = torch.isclose(result, expected, rtol=1.3e-6, atol=1e-5)
    if not close.all():
        raise ContractBroken(f"{broken}: {_first(result, expected, ~close)}")


def _require_same_form(result: Tensor, expected: Tensor, broken: str) -> None:
    if result.shape != expected.shape or result.dtype != expected.dtype:
        kinds = (f"{x.dtype} {list(x.shape)}" for x in (result, expected))
        raise ContractBroken(f"{broken}: {' is not '.join(kinds)}")


def _first(result: Tensor, expected: Tensor, differs: Tensor) -> str:
    """The first index at which two tensors differ, and the values there."""
    if differs.ndim == 0:
        return f"{result.item()}, not {expected.item()}"
    place = tuple(differs.nonzero()[0].tolist())
    count = f"{int(differs.sum())} of {differs.numel()} numbers differ"
    return f"at {list(place)} {result[place].item()}, not {expected[place].item()} ({count})"
