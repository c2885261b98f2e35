"""The levels hold the contracts of their rooms; installed, marl_clean knows them by name."""

import pytest
import torch
from tidy_lab.corridor import Corridor
from tidy_lab.loudest import Loudest

from marl_clean.comm.base import Senders
from marl_clean.testing import check_comm, check_house, check_planner


@pytest.mark.parametrize("message_dim", [1, 16])
def test_the_scheme(message_dim: int) -> None:
    check_comm("loudest", message_dim=message_dim)


def test_the_house() -> None:
    check_house("corridor")
    check_house(Corridor, rooms=[1, 1], width=1, depth=1)


def test_the_planner() -> None:
    check_planner("right_hand")


def test_the_largest_number_is_heard() -> None:
    scheme = Loudest(in_features=2, message_dim=2, hidden=3)
    for layer in (scheme.message, scheme.join[0]):
        torch.nn.init.zeros_(layer.bias)
    torch.nn.init.eye_(scheme.message.weight)
    torch.nn.init.zeros_(scheme.join[0].weight)
    scheme.join[0].weight.data[:2, 2:] = torch.eye(2)
    feature = torch.tensor([[1.0, 5.0], [3.0, 2.0], [4.0, 1.0]])
    live = torch.tensor([[0, 1, 1], [1, 0, 0], [1, 0, 0]], dtype=torch.bool)
    heard = scheme(feature, live, Senders(torch.zeros(3, 3, dtype=torch.int64))).feature
    assert heard[:, :2].tolist() == [[4.0, 2.0], [1.0, 5.0], [1.0, 5.0]]
