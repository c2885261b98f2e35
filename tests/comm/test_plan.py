"""The paper's approach 2: which messages are heard, and in which order."""

import torch

from marl_clean.comm.base import nearest_live, sum_live

VALUE = torch.tensor([[1.0], [2.0], [3.0], [4.0]])
RANK = torch.tensor([[0, 3, 1, 2], [2, 0, 1, 3], [1, 2, 0, 3], [1, 3, 2, 0]])
ALL = ~torch.eye(4, dtype=torch.bool)


def test_the_nearest_come_first_and_the_farthest_is_not_heard():
    assert nearest_live(VALUE, ALL, RANK, slots=2).tolist() == [[3, 4], [3, 1], [1, 2], [1, 3]]


def test_a_dead_edge_gives_its_slot_to_the_next():
    live = ALL.clone()
    live[0, 2] = live[2, 0] = False
    assert nearest_live(VALUE, live, RANK, slots=2)[0].tolist() == [4, 2]


def test_empty_slots_hold_zeros():
    live = torch.zeros(4, 4, dtype=torch.bool)
    live[0, 1] = live[1, 0] = True
    heard = nearest_live(VALUE, live, RANK, slots=5)
    assert heard.tolist() == [[2, 0, 0, 0, 0], [1, 0, 0, 0, 0], [0] * 5, [0] * 5]


def test_sum_adds_the_live_ones():
    live = ALL.clone()
    live[0, 2] = live[2, 0] = False
    assert sum_live(VALUE, live).tolist() == [[6], [8], [6], [6]]
