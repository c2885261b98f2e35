"""Actions are drawn as torch draws them; logits that are not finite fail where they are read."""

import pytest
import torch
from torch.distributions import Categorical

from marl_clean.learning.acting import Choice


def test_of_finite_logits_all_is_torchs_bit_for_bit() -> None:
    logits = torch.randn(64, 4)
    logits[:, 1] = torch.finfo(torch.float32).min  # as a mask writes it
    drawn = []
    for kind in (Choice, Categorical):
        torch.manual_seed(0)
        choice = kind(logits=logits)
        action = choice.sample()
        drawn.append((action, choice.log_prob(action), choice.entropy(), choice.mode))
    assert all(torch.equal(own, torchs) for own, torchs in zip(*drawn, strict=True))


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_draw_of_what_is_not_finite_does_not_fail_and_its_log_prob_says_so(bad: float) -> None:
    logits = torch.zeros(2, 4)
    logits[0, 2] = bad
    choice = Choice(logits=logits)
    action = choice.sample()
    assert ((action >= 0) & (action < 4)).all()
    assert choice.log_prob(action).isfinite().tolist() == [False, True]
    assert choice.entropy().isfinite().all()
