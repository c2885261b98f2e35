"""The square's symmetries: what is seen and what is done turn alike."""

import pytest
import torch

from marl_clean.learning.symmetry import NUM_SYMMETRIES, turn_action, turn_in_eighths, turn_square

MOVES = [(-1, 0), (0, 1), (1, 0), (0, -1)]
ELEMENTS = range(NUM_SYMMETRIES)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("action", range(4))
def test_the_cell_an_action_leads_to_turns_with_the_square(element, action):
    square = torch.zeros(5, 5)
    row, col = MOVES[action]
    square[2 + row, 2 + col] = 1
    row, col = MOVES[turn_action(torch.tensor(action), element)]
    assert turn_square(square, element)[2 + row, 2 + col] == 1


def test_the_eight_are_different_and_keep_neighbours():
    square = torch.arange(9.0).reshape(3, 3)
    turned = [turn_square(square, element) for element in ELEMENTS]
    assert len({tuple(x.flatten().tolist()) for x in turned}) == NUM_SYMMETRIES
    assert all(x[1, 1] == 4 and x[0, 1] + x[2, 1] == 8 for x in turned)


@pytest.mark.parametrize("count", [1, 8, 21])
def test_every_frame_is_turned_as_a_whole(count):
    now, then = torch.randn(count, 3, 1, 5, 5), torch.randn(count, 3, 1, 5, 5)
    action = torch.randint(4, (count, 3))
    (turned_now, turned_then), turned_action = turn_in_eighths([now, then], action)
    used = set()
    for frame in range(count):
        fitting = [
            element
            for element in ELEMENTS
            if torch.equal(turn_square(now[frame], element), turned_now[frame])
        ]
        assert len(fitting) == 1
        assert torch.equal(turn_square(then[frame], fitting[0]), turned_then[frame])
        assert torch.equal(turn_action(action[frame], fitting[0]), turned_action[frame])
        used |= set(fitting)
    assert len(used) == min(count, NUM_SYMMETRIES)
