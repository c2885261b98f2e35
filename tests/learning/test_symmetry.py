"""The square's symmetries: what is seen and what is done rotate alike."""

import pytest
import torch

from marl_clean.learning.symmetry import (
    NUM_SYMMETRIES,
    rotate_action,
    rotate_in_eighths,
    rotate_offset,
    rotate_square,
)

MOVES = [(-1, 0), (0, 1), (1, 0), (0, -1)]
ELEMENTS = range(NUM_SYMMETRIES)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("action", range(4))
def test_the_cell_an_action_leads_to_rotates_with_the_square(element, action):
    square = torch.zeros(5, 5)
    row, col = MOVES[action]
    square[2 + row, 2 + col] = 1
    row, col = MOVES[rotate_action(torch.tensor(action), element)]
    assert rotate_square(square, element)[2 + row, 2 + col] == 1


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("offset", [(-2, 1), (0, 2), (1, 1), (2, -1)])
def test_an_offset_rotates_with_the_square(element, offset):
    square = torch.zeros(5, 5)
    square[2 + offset[0], 2 + offset[1]] = 1
    row, col = rotate_offset(torch.tensor(offset), element).tolist()
    assert rotate_square(square, element)[2 + row, 2 + col] == 1


def test_the_eight_are_different_and_keep_neighbours():
    square = torch.arange(9.0).reshape(3, 3)
    rotated = [rotate_square(square, element) for element in ELEMENTS]
    assert len({tuple(x.flatten().tolist()) for x in rotated}) == NUM_SYMMETRIES
    assert all(x[1, 1] == 4 and x[0, 1] + x[2, 1] == 8 for x in rotated)


@pytest.mark.parametrize("count", [1, 8, 21])
def test_every_frame_is_rotated_as_a_whole(count):
    now, then = torch.randn(count, 3, 1, 5, 5), torch.randn(count, 3, 1, 5, 5)
    action = torch.randint(4, (count, 3))
    (rotated_now, rotated_then), rotated_action = rotate_in_eighths([now, then], action)
    used = set()
    for frame in range(count):
        fitting = [
            element
            for element in ELEMENTS
            if torch.equal(rotate_square(now[frame], element), rotated_now[frame])
        ]
        assert len(fitting) == 1
        assert torch.equal(rotate_square(then[frame], fitting[0]), rotated_then[frame])
        assert torch.equal(rotate_action(action[frame], fitting[0]), rotated_action[frame])
        used |= set(fitting)
    assert len(used) == min(count, NUM_SYMMETRIES)
