"""The checks of shapes and types see a wrong one in a first call, and soon in a later one."""

import pytest
import torch
from beartype import beartype
from jaxtyping import Float, TypeCheckError
from torch import Tensor

from marl_clean.world.sensing import in_radius
from tests import checks


def test_functions_of_the_package_are_checked() -> None:
    with pytest.raises(TypeCheckError, match="in_radius"):
        in_radius(torch.zeros(3), 3.0)


def test_a_wrong_shape_is_seen_however_late_it_comes() -> None:
    @checks.sparingly(typechecker=beartype)
    def halved(map_: Float[Tensor, "row col"]) -> Float[Tensor, "row col"]:
        return map_ / 2 if map_.numel() else map_[0]

    for seen_before in (0, 5, 200):
        for _ in range(seen_before):
            halved(torch.ones(3, 7))
        with pytest.raises(TypeCheckError):
            for _ in range(checks.ONE_IN):
                halved(torch.ones(3))


def test_every_test_begins_with_checks_of_all_calls() -> None:
    assert max(checks.calls.values(), default=0) < checks.FIRST
