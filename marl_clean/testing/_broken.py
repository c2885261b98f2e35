"""The error that a broken contract raises, and how a level is held against its clauses."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

from marl_clean.errors import BadInput

Clause = Callable[[Any], None]
"""One promise of a room: takes what it is held against, raises ContractBroken; its docstring's
first line is the promise."""


class ContractBroken(AssertionError):
    """A level does not keep what its room promises: what is broken, and on which numbers."""


def verify(label: str, clauses: Iterable[Clause], subject: Any) -> None:
    """Hold a level against every clause, in order.

    Raises:
        ContractBroken: the first clause that does not hold. Whatever else the level raises, such
            as an error of shapes, breaks the clause that met it. `BadInput` passes as it is.
    """
    for clause in clauses:
        try:
            clause(subject)
        except ContractBroken as broken:
            raise ContractBroken(f"{label}: {broken}") from None
        except BadInput:
            raise
        except Exception as error:  # of somebody else's code: anything may come
            reason = (str(error).strip() or "no message").splitlines()[0]
            promise = (clause.__doc__ or clause.__name__).splitlines()[0].rstrip(".")
            raise ContractBroken(
                f"{label}: {type(error).__name__} ({reason}) where the contract is: {promise}"
            ) from error


def require(holds: bool | Tensor, broken: str) -> None:
    """Raise ContractBroken(broken) unless it holds; a tensor holds where all of it is true."""
    if not (bool(holds.all()) if isinstance(holds, Tensor) else holds):
        raise ContractBroken(broken)


def require_equal(mine: Tensor, other: Tensor, broken: str) -> None:
    """Raise ContractBroken, with the numbers, unless two tensors are the same to the bit."""
    _require_alike(mine, other, broken)
    if not torch.equal(mine, other):
        raise ContractBroken(f"{broken}: {_first(mine, other, mine != other)}")


def require_close(mine: Tensor, other: Tensor, broken: str, tolerance: float | None = None) -> None:
    """Raise ContractBroken, with the numbers, unless two tensors are the same but for rounding.

    `tolerance` is absolute; without one it is that of the dtype.
    """
    _require_alike(mine, other, broken)
    if not mine.is_floating_point():
        require_equal(mine, other, broken)
        return
    if tolerance is not None:
        close = torch.isclose(mine, other, rtol=0.0, atol=tolerance)
    elif mine.dtype == torch.float64:
        close = torch.isclose(mine, other, rtol=1e-7, atol=1e-7)
    else:
        close = torch.isclose(mine, other, rtol=1.3e-6, atol=1e-5)
    if not close.all():
        raise ContractBroken(f"{broken}: {_first(mine, other, ~close)}")


def _require_alike(mine: Tensor, other: Tensor, broken: str) -> None:
    if mine.shape != other.shape or mine.dtype != other.dtype:
        kinds = (f"{x.dtype} {list(x.shape)}" for x in (mine, other))
        raise ContractBroken(f"{broken}: {' is not '.join(kinds)}")


def _first(mine: Tensor, other: Tensor, differs: Tensor) -> str:
    """The first place where two tensors differ, and what stands there."""
    if differs.ndim == 0:
        return f"{mine.item()}, not {other.item()}"
    place = tuple(differs.nonzero()[0].tolist())
    count = f"{int(differs.sum())} of {differs.numel()} numbers differ"
    return f"at {list(place)} {mine[place].item()}, not {other[place].item()} ({count})"
